"""All that is written goes through torchds/files.py, so that a file is whole or not there; the exceptions are named here."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
MODULES = [path for room in ("torchds", "tasks", "train") for path in sorted((ROOT / room).rglob("*.py"))]

OPENERS = {"open", "fdopen", "ZipFile"}  # write only in some modes
WRITERS = {
    "savefig",
    "savetxt",
    "savez",
    "savez_compressed",
    "tofile",
    "to_csv",
    "imwrite",
    "write_bytes",
    "write_text",
}
WRITERS |= {
    "save",
    "dump",
    "SummaryWriter",
    "FileWriter",
    "NamedTemporaryFile",
    "mkstemp",
    "copy2",
    "copyfile",
    "copytree",
}
EXACT = {"os.replace", "os.rename", "shutil.move", "shutil.copy"}

IN_MEMORY = {"buffer", "stream"}  # a BytesIO, or what `write_atomically` gives
OURS = {"files", "agents", "mixture", "plotting", "policy"}  # whose `save` is tested here too

ALLOWED = {
    "torchds/archives.py": {"os.open", "os.fdopen", "os.replace"},  # what this is about
    "torchds/locks.py": {"os.open"},  # an empty file beside what it locks
    "torchds/monitor/events.py": {"os.open", "os.fdopen"},  # grows; a checkpoint says how long it was
    "train/compare/sweep/claims.py": {"os.open", "os.fdopen"},  # a file that one worker alone can make
    "train/__main__.py": {"open"},  # the null device, for a pipe that was closed
}


def writes(source):
    """The calls of a module that write files by themselves, with their lines."""
    found = []
    for call in (node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Call)):
        name = ".".join(ast.unparse(call.func).split(".")[-2:])
        owner, _, last = name.rpartition(".")
        if not (last in WRITERS or name in EXACT or (last in OPENERS and not reads(call, owner))):
            continue
        names = {node.id for argument in call.args for node in ast.walk(argument) if isinstance(node, ast.Name)}
        ours = (last == "write_text" and not owner) or (last == "save" and (owner in OURS or not call.args))
        if not ours and not names & IN_MEMORY:
            found.append((name, call.lineno))
    return found


def reads(call, owner):
    """Whether what opens a file opens it for reading; an `open` of our own classes does not count."""
    if owner[:1].isupper():
        return True
    if owner == "os":
        return (
            "O_CREAT" not in ast.unparse(call) and ast.unparse(call).count("'w") + ast.unparse(call).count("'r+") == 0
        )
    method = owner and owner not in ("io", "zipfile")
    modes = call.args[0 if method else 1 :][:1] or [word.value for word in call.keywords if word.arg == "mode"]
    return all(isinstance(mode, ast.Constant) and not set("wax+") & set(str(mode.value)) for mode in modes)


@pytest.mark.slow
def test_no_module_writes_files_by_itself():
    found = {path.relative_to(ROOT).as_posix(): writes(path.read_text()) for path in MODULES}
    strange = [
        (module, *call) for module, calls in found.items() for call in calls if call[0] not in ALLOWED.get(module, ())
    ]
    assert not strange, "write with torchds.files.write_atomically, or with what is made of it"
    assert {module: {name for name, _ in found[module]} for module in ALLOWED} == ALLOWED


@pytest.mark.slow
def test_what_is_called_a_buffer_is_memory():
    for path in MODULES:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Assign) and {ast.unparse(target) for target in node.targets} & IN_MEMORY:
                assert ast.unparse(node.value).startswith(("io.BytesIO(", "io.StringIO(")), (path, node.lineno)


@pytest.mark.parametrize(
    "line",
    [
        "open(path, 'w')",
        "open(path, mode='x')",
        "path.open('a', newline='')",
        "path.open(mode)",
        "(folder / name).open('w')",
        "os.open(path, os.O_WRONLY | os.O_CREAT)",
        "os.fdopen(handle, 'r+b')",
        "made.figure.savefig(folder / 'a.png')",
        "np.savez(path, x=x)",
        "torch.save(state, path)",
        "agent.save(folder / 'agent.zip')",
        "(folder / name).write_text(text)",
        "pickle.dump(agent, file)",
        "zipfile.ZipFile(path, 'w')",
        "SummaryWriter(str(folder))",
        "os.replace(a, b)",
        "shutil.copyfile(a, b)",
    ],
)
def test_a_writer_is_seen(line):
    assert writes(line)


@pytest.mark.parametrize(
    "line",
    [
        "open(path)",
        "path.open('rb')",
        "path.open(newline='', encoding='utf-8-sig')",
        "os.open(folder, os.O_RDONLY)",
        "zipfile.ZipFile(path)",
        "Session.open(folder)",
        "figure.savefig(buffer)",
        "write_text(path, text)",
        "text.replace(a, b)",
        "replace(options, updates=3)",
        "files.save(path, 'policy', state)",
    ],
)
def test_what_does_not_write_a_file_is_left_alone(line):
    assert not writes(line)
