"""The closing table of the property tests: cases and failures of each class of fault."""

from collections import Counter
from pathlib import Path

from tests.faults.cases import TRIED

failed: Counter[str] = Counter()


def pytest_runtest_logreport(report):
    path = Path(report.nodeid.partition("::")[0])
    if report.failed and path.parent.name == "faults":
        failed[path.stem] += 1


def pytest_sessionfinish(session):
    if hasattr(session.config, "workeroutput"):
        session.config.workeroutput["tried"] = dict(TRIED)


def pytest_testnodedown(node):
    TRIED.update(getattr(node, "workeroutput", {}).get("tried", {}))


def pytest_terminal_summary(terminalreporter):
    if TRIED:
        terminalreporter.write_line("| class of fault | cases | failures |")
        terminalreporter.write_line("|---|---|---|")
        for name in sorted(TRIED):
            terminalreporter.write_line(f"| {name.removeprefix('test_')} | {TRIED[name]} | {failed[name]} |")
