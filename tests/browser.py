"""A browser without a window, Debian's chromium, for tests of pages."""

import functools
import http.server
import json
import os
import queue
import shutil
import subprocess
import tempfile
import threading
from pathlib import Path
from typing import Any

import pytest

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
BROWSER = next(filter(None, map(shutil.which, BROWSERS)), None)
needs_browser = pytest.mark.skipif(BROWSER is None, reason=f"needs a browser: {', '.join(BROWSERS)}")


class Handler(http.server.SimpleHTTPRequestHandler):
    """HTTP server of a folder and of a harness page from another folder. Puts posted JSON into a queue."""

    def __init__(self, *arguments, harness, answers, **keywords):
        self._harness, self._answers = harness, answers
        super().__init__(*arguments, **keywords)

    def translate_path(self, path):
        name = path.partition("?")[0].removeprefix("/")
        return str(self._harness) if name == self._harness.name else super().translate_path(path)

    def do_POST(self):
        self._answers.put(json.loads(self.rfile.read(int(self.headers["Content-Length"]))))
        self.send_response(204)
        self.end_headers()

    def log_message(self, *arguments):
        pass


def visit(folder: Path, harness: Path, query: str, timeout: float = 120.0) -> dict[str, Any]:
    """Open a harness page of a folder; return the posted JSON and the processor time of the browser [s]."""
    answers: queue.Queue[dict[str, Any]] = queue.Queue()
    handler = functools.partial(Handler, directory=folder, harness=harness, answers=answers)
    with (
        tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile,
        http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server,
    ):
        threading.Thread(target=server.serve_forever, daemon=True).start()
        root = ["--no-sandbox"] if os.geteuid() == 0 else []  # chromium refuses a sandbox to root
        options = ["--headless=new", "--disable-gpu", "--no-first-run", f"--user-data-dir={profile}", *root]
        address = f"http://127.0.0.1:{server.server_address[1]}/{harness.name}?{query}"
        silent = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        process = subprocess.Popen([BROWSER, *options, address], start_new_session=True, **silent)
        try:
            return answers.get(timeout=timeout) | {"processor_time": processor_time(process.pid)}
        finally:
            process.terminate()
            process.wait()
            server.shutdown()


def processor_time(session: int) -> float:
    """Return the processor time of all processes of a session so far [s]."""
    ticks = 0
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = path.read_text().rpartition(")")[2].split()
        except OSError:  # it has ended
            continue
        if int(fields[3]) == session:
            ticks += int(fields[11]) + int(fields[12])
    return ticks / os.sysconf("SC_CLK_TCK")
