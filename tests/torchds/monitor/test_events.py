from types import SimpleNamespace

import numpy as np
import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from tensorboard.plugins.custom_scalar import layout_pb2

from torchds.errors import FileError
from torchds.monitor.events import NAME, Events


def read(folder):
    return EventAccumulator(str(folder), size_guidance={"scalars": 0, "images": 0}).Reload()


def test_scalars_are_read_as_they_were_written(tmp_path):
    with Events(tmp_path) as events:
        for step in (0, 10, 20):
            events.scalars({"cost/total": 1 / (step + 1), "rollouts/updates": step // 10}, step)
    seen = read(tmp_path).Scalars("cost/total")
    assert [event.step for event in seen] == [0, 10, 20]
    assert [event.value for event in seen] == pytest.approx([1, 1 / 11, 1 / 21], rel=1e-7)


def test_what_is_written_is_seen_before_the_file_is_closed(tmp_path):
    events = Events(tmp_path)
    events.scalars({"a": 1.0}, 0)
    length = events.write()
    assert length == (tmp_path / NAME).stat().st_size and read(tmp_path).Tags()["scalars"] == ["a"]
    events.close()


def test_a_file_is_cut_to_the_length_of_a_checkpoint(tmp_path):
    with Events(tmp_path) as events:
        events.scalars({"a": 1.0}, 0)
        length = events.flush()
        events.scalars({"a": 2.0}, 1)
    with Events(tmp_path, length) as events:
        assert not events.lost
        events.scalars({"a": 3.0}, 1)
    assert [event.value for event in read(tmp_path).Scalars("a")] == [1.0, 3.0]


def test_a_file_shorter_than_the_checkpoint_says_is_begun_anew(tmp_path):
    with Events(tmp_path, 1000) as events:
        assert events.lost
        events.scalars({"a": 1.0}, 0)
    assert len(read(tmp_path).Scalars("a")) == 1


def test_what_a_full_disk_refused_is_written_whole_once_there_is_room(tmp_path):
    with Events(tmp_path) as events:
        length, disk = events.write(), events._file
        events.scalars({"a": 1.0}, 0)

        def half(data):
            if left := disk.write(data[: min(20, length + 20 - disk.tell())]):
                return left
            raise OSError(28, "No space left on device")

        events._file = SimpleNamespace(write=half, tell=disk.tell, seek=disk.seek, truncate=disk.truncate)
        with pytest.raises(FileError, match="No space left on device"):
            events.write()
        assert (tmp_path / NAME).stat().st_size == length
        events._file = disk
        events.scalars({"a": 2.0}, 1)
    assert [event.value for event in read(tmp_path).Scalars("a")] == [1.0, 2.0]


def test_a_place_that_cannot_be_written_is_named(tmp_path):
    with pytest.raises(FileError, match=r"events\.out\.tfevents\.run cannot be written: "):
        Events(tmp_path / "nowhere")


def test_a_median_and_its_quartiles_are_one_chart(tmp_path):
    with Events(tmp_path) as events:
        events.charts()
    (event,) = read(tmp_path).Tensors("custom_scalars__config__")
    layout = layout_pb2.Layout()
    layout.ParseFromString(event.tensor_proto.string_val[0])
    charts = [chart for category in layout.category for chart in category.chart]
    bands = [chart.margin.series[0] for chart in charts if chart.HasField("margin")]
    assert [(band.value, band.lower, band.upper) for band in bands] == [
        (f"cost/{name}", f"cost/{name}_q1", f"cost/{name}_q3") for name in ("total", "tried")
    ]


def test_pictures_are_shown(tmp_path):
    with Events(tmp_path) as events:
        events.image("trial/end", np.zeros((4, 6, 3), dtype=np.uint8), 7)
    (seen,) = read(tmp_path).Images("trial/end")
    assert (seen.step, seen.width, seen.height) == (7, 6, 4)
