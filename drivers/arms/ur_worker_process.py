"""The worker process of a UR arm as seen by the application: requests, answers, and its end."""

from __future__ import annotations

import json
import os
import queue
import subprocess
import sys
import threading
from contextlib import suppress
from pathlib import Path
from typing import Any

import drivers


class WorkerGone(Exception):
    """The worker process has ended, or did not answer in time; the message is the reason."""


class WorkerRefusal(Exception):
    """The worker refused a request, or reports that the arm did not execute it."""

    def __init__(self, kind: str, text: str) -> None:
        super().__init__(text)
        self.kind, self.text = kind, text


class WorkerProcess:
    """A worker process. Calls may come from several threads."""

    def __init__(self, name: str) -> None:
        root = str(Path(drivers.__file__).parents[1])
        paths = [root, *filter(None, [os.environ.get("PYTHONPATH")])]
        self._process = subprocess.Popen(
            [sys.executable, "-m", "drivers.arms.ur_worker"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(paths)},
            start_new_session=True,  # a Ctrl-C in the terminal must not reach it
        )
        self._lock = threading.Lock()
        self._number = 0
        self._pending: dict[int, queue.SimpleQueue[dict[str, Any] | None]] = {}
        self._hello: queue.SimpleQueue[None] = queue.SimpleQueue()
        self._ended = ""
        self._reader = threading.Thread(target=self._read, name=f"UR worker of {name}", daemon=True)
        self._reader.start()

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    @property
    def ended(self) -> str:
        """Why the process has ended; empty while it runs."""
        return self._ended

    def wait_hello(self, timeout_s: float) -> None:
        """Wait until the process serves requests. Raises ``WorkerGone``."""
        try:
            self._hello.get(timeout=timeout_s)
        except queue.Empty:
            raise WorkerGone(f"its driver process did not start within {timeout_s:g} s") from None
        if self._ended:
            raise WorkerGone(self._ended)

    def call(self, request: str, within_s: float, **arguments: Any) -> dict[str, Any]:
        """Send a request and return its answer. Raises ``WorkerGone`` or ``WorkerRefusal``."""
        answered: queue.SimpleQueue[dict[str, Any] | None] = queue.SimpleQueue()
        with self._lock:
            if self._ended:
                raise WorkerGone(self._ended)
            self._number += 1
            number = self._number
            self._pending[number] = answered
            try:
                assert self._process.stdin is not None
                line = json.dumps({"id": number, "do": request, **arguments})
                self._process.stdin.write(line.encode("ascii") + b"\n")
                self._process.stdin.flush()
            except OSError as error:
                raise WorkerGone(f"its driver process accepts no requests ({error})") from error
        try:
            answer = answered.get(timeout=within_s)
        except queue.Empty:
            raise WorkerGone(f"no answer to '{request}' within {within_s:g} s") from None
        finally:
            with self._lock:
                self._pending.pop(number, None)
        if answer is None:
            raise WorkerGone(self._ended)
        if "error" in answer:
            raise WorkerRefusal(str(answer["error"]), str(answer["text"]))
        return dict(answer["ok"])

    def kill(self) -> None:
        """Kill the process; harmless when it has ended."""
        self._process.kill()
        self._join()

    def end(self, timeout_s: float) -> None:
        """Let the process stop the program and end by itself; kill it if it does not end in time."""
        with self._lock, suppress(OSError):
            assert self._process.stdin is not None
            self._process.stdin.close()
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(timeout_s)
        self.kill()

    def _join(self) -> None:
        self._process.wait()
        self._reader.join()
        for pipe in (self._process.stdin, self._process.stdout):
            assert pipe is not None
            with suppress(OSError):
                pipe.close()

    def _read(self) -> None:
        reason = ""
        assert self._process.stdout is not None
        for line in self._process.stdout:
            if not line.endswith(b"\n"):  # the process ended in the middle of a line
                break
            answer = json.loads(line)
            if "hello" in answer:
                self._hello.put(None)
            elif "lost" in answer:
                reason = str(answer["lost"])
            else:
                with self._lock:
                    answers = self._pending.get(int(answer["id"]))
                if answers is not None:
                    answers.put(answer)
        code = self._process.wait()
        with self._lock:
            how = f"signal {-code}" if code < 0 else f"exit code {code}"
            self._ended = reason or f"its driver process ended ({how})"
            for answers in self._pending.values():
                answers.put(None)
        self._hello.put(None)
