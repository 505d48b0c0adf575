"""The command: its port, its folder, and a page that only this machine sees."""

import socket

import pytest

from torchds.errors import FileError, InvalidArgumentError
from torchds.locks import one_writer
from train.view.studio.command import Studio, free


def test_a_port_that_is_taken_is_a_sentence():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(InvalidArgumentError, match=f"got {port}"):
            free(port)
    assert free(0) > 0


@pytest.mark.parametrize("port", [-1, 70_000])
def test_a_port_that_does_not_exist_is_a_sentence(port):
    with pytest.raises(InvalidArgumentError, match=f"got {port}"):
        free(port)


def test_two_studios_do_not_share_a_folder(tmp_path):
    pytest.importorskip("nicegui")
    with one_writer(tmp_path), pytest.raises(FileError, match="in use"):
        Studio(folder=tmp_path, show=False).main()
