"""What the script of the table does by itself, without a browser."""

import json
import shutil
import subprocess
from pathlib import Path

import pytest

pytest.importorskip("nicegui")

from train.view.studio import drawing

NODE = shutil.which("node")
pytestmark = pytest.mark.skipif(NODE is None, reason="no node")
LISTENING = """
const said = [], call = (name, event) => table.methods[name].call(page, event);
const page = { ...table.methods, pointer: null, tool: TOOL, layers: { view: [-1, 1, -1, 1], via: [[0.5, 0]] }, ask() {},
  $emit(name, what) { said.push([name, what]); },
  $el: { clientWidth: 200, clientHeight: 200, setPointerCapture() {}, getBoundingClientRect: () => ({ left: 0, top: 0 }) } };
const event = (type, x, y) => ({ type, clientX: x, clientY: y, pointerId: 1, button: 0, timeStamp: 1000 });
call("down", event("pointerdown", 150, 100));
call("move", event("pointermove", 180, 150));
call("up", event(END, 0, 0));
console.log(JSON.stringify(said.at(-1)));
"""


@pytest.fixture
def js(tmp_path):
    """What a script prints that has the table's module, as JSON."""
    (tmp_path / "drawing.mjs").write_text(Path(drawing.__file__).with_suffix(".js").read_text())

    def run(script):
        (tmp_path / "it.mjs").write_text(f'import table, {{ multiples }} from "./drawing.mjs";\n{script}')
        ran = subprocess.run([NODE, tmp_path / "it.mjs"], capture_output=True, text=True, timeout=60)
        assert ran.returncode == 0, ran.stderr
        return json.loads(ran.stdout)

    return run


def test_lines_of_the_grid_end_whatever_the_table_is(js):
    cases = [(0.5, -1, 1), (1e-11, 5, 5 + 1.01e-10), (1e-9, 1e8, 1e8 + 1e-8), (0, 1, 1), (1, 3.2, 3.8), (1e-9, 0, 1e6)]
    found = js(f"console.log(JSON.stringify({json.dumps(cases)}.map((each) => multiples(...each))))")
    assert found[0] == [-1, -0.5, 0, 0.5, 1] and found[1] == pytest.approx([5 + 1e-11 * i for i in range(11)])
    assert all(map(len, (found[1], found[2]))) and found[3] == found[4] == [] and max(map(len, found)) <= 1000


@pytest.mark.parametrize("end, at", [("pointercancel", [0.8, -0.5]), ("pointerup", [-1, 1])])
def test_a_pointer_that_is_cancelled_was_let_go_where_it_was_seen_last(js, end, at):
    begin = f"globalThis.window = {{}}; const END = {json.dumps(end)}, TOOL = "
    assert js(f'{begin}"wall";{LISTENING}') == ["place", {"kind": "walls", "from": [0.5, 0], "to": at}]
    assert js(f'{begin}"move";{LISTENING}') == ["drag", {"kind": "via", "index": 0, "at": at, "done": True}]
