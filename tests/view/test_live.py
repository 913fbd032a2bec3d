"""The served page: only this machine reaches it, and it follows its file."""

from __future__ import annotations

import http.client
import json
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from micah_plan.errors import InputError
from micah_plan.view.live import PageServer, remade_on_change


@pytest.fixture
def file(tmp_path: Path) -> Path:
    place = tmp_path / "page.txt"
    place.write_text("first")
    return place


@pytest.fixture
def server(file: Path) -> Iterator[PageServer]:
    def make() -> str:
        if file.read_text() == "broken":
            raise InputError("expected a page", source=file)
        return file.read_text()

    with PageServer(remade_on_change(file, make)) as served:
        thread = threading.Thread(target=served.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        yield served
        served.shutdown()
        thread.join()


def answer(port: int, path: str = "/", **headers: str) -> tuple[int, str]:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
    connection.request("GET", path, headers=headers)
    response = connection.getresponse()
    text = response.read().decode()
    connection.close()
    return response.status, text


def test_only_the_loopback_address_is_bound(server: PageServer) -> None:
    assert server.socket.getsockname()[0] == "127.0.0.1"
    assert server.url == f"http://127.0.0.1:{server.port}/"
    for address in ("127.0.0.2", *addresses_of_this_machine()):
        with pytest.raises(OSError, match=r"refused|unreachable|timed out"):
            socket.create_connection((address, server.port), timeout=2).close()


def addresses_of_this_machine() -> list[str]:
    """Those by which others would reach it, found without sending anything."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))
        except OSError:
            return []  # a machine without any network
        return [probe.getsockname()[0]]


def test_the_page_is_served_and_made_again_when_the_file_changes(server: PageServer, file: Path) -> None:
    assert answer(server.port) == (200, "first")
    file.write_text("the second")
    assert answer(server.port) == (200, "the second")
    file.write_text("broken")
    assert answer(server.port) == (500, f"error: {file}: expected a page\n")
    file.unlink()
    status, text = answer(server.port)
    assert status == 500
    assert "check the path" in text
    file.write_text("mended")
    assert answer(server.port) == (200, "mended")


def test_an_unchanged_file_is_not_read_twice(file: Path) -> None:
    made: list[int] = []
    page = remade_on_change(file, lambda: made.append(1) or "page")
    assert [page(), page()] == ["page", "page"]
    assert len(made) == 1


def test_other_paths_and_other_names_for_this_machine_are_refused(server: PageServer) -> None:
    for path in ("/../../etc/passwd", "/x?y"):
        assert answer(server.port, path)[0] == 404, path
    assert answer(server.port, "/?again") == (200, "first")
    assert answer(server.port, Host=f"localhost:{server.port}") == (200, "first")
    for name in ("evil.example", f"evil.example:{server.port}", "127.0.0.1", ""):
        assert answer(server.port, Host=name)[0] == 403, name


def test_what_is_no_request_is_harmless(server: PageServer, capsys: pytest.CaptureFixture[str]) -> None:
    for sent in (
        b"",
        b"\x00\xff\r\n\r\n",
        b"GET / HTTP/9.9\r\n\r\n",
        b"GET /" + b"a" * 100_000,
        b"POST / HTTP/1.1\r\n\r\n",
        b"GET http://[ HTTP/1.1\r\nHost: 127.0.0.1:%d\r\n\r\n" % server.port,
    ):
        with socket.create_connection(("127.0.0.1", server.port), timeout=10) as connection:
            connection.sendall(sent)
            # Closed at once, with a reset: whatever is written to it then fails.
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\x01\x00\x00\x00\x00\x00\x00\x00")
    assert answer(server.port) == (200, "first")
    assert capsys.readouterr().err == ""


def test_many_requests_at_once_are_all_answered(server: PageServer) -> None:
    with ThreadPoolExecutor(300) as browsers:
        answers = list(browsers.map(lambda _: answer(server.port), range(300)))
    assert answers == [(200, "first")] * 300


def test_a_port_that_is_taken_is_bad_input(server: PageServer) -> None:
    with pytest.raises(InputError, match=r"port \d+ of 127\.0\.0\.1 cannot be used.*--port"):
        PageServer(str, server.port)


def listen_to_interrupts() -> None:
    """Tests that run in the background of a shell ignore them, and so would the command that they start."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


@pytest.mark.slow
def test_the_command_serves_until_it_is_interrupted_and_ends_well(repository: Path) -> None:
    command = [sys.executable, "-W", "error", "-m", "micah_plan", "show", "models/drawer.yaml", "--live", "--json"]
    with subprocess.Popen(
        command,
        cwd=repository,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=listen_to_interrupts,
    ) as process:
        try:
            assert process.stdout is not None
            told = json.loads(process.stdout.readline())
            port = int(told["url"].split(":")[2].strip("/"))
            status, page = answer(port)
            process.send_signal(signal.SIGINT)
            rest = process.communicate(timeout=30)
        finally:
            process.kill()
    assert (status, len(page.encode())) == (200, told["bytes"])
    assert page.startswith("<!DOCTYPE html>")
    assert (process.returncode, rest) == (0, ("", ""))
    with pytest.raises(ConnectionRefusedError):
        answer(port)
