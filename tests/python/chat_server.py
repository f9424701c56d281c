"""A server on this machine that speaks the chat-completions protocol, well or badly as a test wants it.

`ChatServer([turn, ...])` answers one request by each turn, the last one for ever after; it keeps what it got.
"""

from __future__ import annotations

import base64
import contextlib
import gzip
import json
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from types import TracebackType
from typing import Any

import cv2
import numpy as np

HUGE = 10_000_000


@dataclass(frozen=True)
class Got:
    """One request."""

    path: str
    headers: dict[str, str]
    body: dict[str, Any]

    @property
    def texts(self) -> list[str]:
        """All words of all messages."""
        found = []
        for message in self.body["messages"]:
            content = message["content"]
            parts = [{"type": "text", "text": content}] if isinstance(content, str) else content
            found += [p["text"] for p in parts if p["type"] == "text"]
        return found

    @property
    def pictures(self) -> list[np.ndarray]:
        """All pictures, decoded: (H, W, 3) RGB or (H, W) grey."""
        found = []
        for message in self.body["messages"]:
            for part in message["content"]:
                if isinstance(part, dict) and part["type"] == "image_url":
                    head, data = part["image_url"]["url"].split(",", 1)
                    assert head == "data:image/png;base64"
                    picture = cv2.imdecode(
                        np.frombuffer(base64.b64decode(data), np.uint8), cv2.IMREAD_UNCHANGED
                    )
                    assert picture is not None
                    found.append(picture[..., ::-1] if picture.ndim == 3 else picture)
        return found


Turn = Callable[["_Handler", Got], None]


def completion(content: str | None, finish: Any = "stop") -> bytes:
    message = {"role": "assistant", "content": content}
    choice = {"index": 0, "message": message, "finish_reason": finish}
    usage = {"prompt_tokens": 7, "completion_tokens": 5, "total_tokens": 12}
    head = {"id": "c", "object": "chat.completion", "created": 0, "model": "served"}
    return json.dumps({**head, "choices": [choice], "usage": usage}).encode()


def good(content: Any) -> Turn:
    """A completion; `content` is its text, or JSON, or makes either from the request."""

    def turn(handler: _Handler, got: Got) -> None:
        made = content(got) if callable(content) else content
        handler.send(200, completion(made if isinstance(made, str) else json.dumps(made)))

    return turn


def status(code: int, body: Any = "busy", **headers: str) -> Turn:
    raw = json.dumps({"error": {"message": body}}).encode() if isinstance(body, str) else body
    return lambda handler, got: handler.send(code, raw, {k.replace("_", "-"): v for k, v in headers.items()})


def raw(body: bytes) -> Turn:
    """Status 200 with anything."""
    return lambda handler, got: handler.send(200, body)


def packed(body: bytes) -> Turn:
    """The same through gzip: what is small on the wire need not be."""
    squeezed = gzip.compress(body)
    return lambda handler, got: handler.send(200, squeezed, {"Content-Encoding": "gzip"})


def slow(handler: _Handler, got: Got) -> None:
    """No reply until the test is over."""
    handler.server.closing.wait(30)  # type: ignore[attr-defined]


def trickle(handler: _Handler, got: Got) -> None:
    """A byte now and then, which no time limit of a single read ends."""
    handler.head(200, {"Content-Length": "10000"})
    while not handler.server.closing.wait(0.05):  # type: ignore[attr-defined]
        handler.wfile.write(b" ")


def truncated(handler: _Handler, got: Got) -> None:
    """Less than was announced."""
    whole = completion("{}")
    handler.head(200, {"Content-Length": str(len(whole) + 100)})
    handler.wfile.write(whole)


def hang_up(handler: _Handler, got: Got) -> None:
    """Nothing at all."""


def huge(handler: _Handler, got: Got) -> None:
    """Ten megabytes; `server.written` says how many of them anybody took."""
    handler.head(200, {"Content-Length": str(HUGE)})
    for _ in range(HUGE // 100_000):
        handler.wfile.write(b"x" * 100_000)
        handler.server.written += 100_000  # type: ignore[attr-defined]


def no_schema(otherwise: Turn) -> Turn:
    """Refuses `response_format`, as servers do that do not know it."""

    def turn(handler: _Handler, got: Got) -> None:
        if "response_format" in got.body:
            status(400, "Unknown parameter: response_format")(handler, got)
        else:
            otherwise(handler, got)

    return turn


def wants_key(key: str, otherwise: Turn) -> Turn:
    def turn(handler: _Handler, got: Got) -> None:
        sent = got.headers.get("Authorization", "")
        if sent == f"Bearer {key}":
            otherwise(handler, got)
        else:
            status(401, f"Incorrect API key provided: {sent}")(handler, got)

    return turn


class ChatServer:
    """`url` is its base_url; `got` all requests in their order."""

    def __init__(self, turns: Sequence[Turn] | Turn):
        self._turns = [turns] if callable(turns) else list(turns)
        self._lock = threading.Lock()
        self.got: list[Got] = []
        self._server = ThreadingHTTPServer(("127.0.0.1", 0), _Handler)
        self._server.daemon_threads = True
        self._server.closing = threading.Event()  # type: ignore[attr-defined]
        self._server.written = 0  # type: ignore[attr-defined]
        self._server.answer = self._answer  # type: ignore[attr-defined]
        self.url = f"http://127.0.0.1:{self._server.server_address[1]}/v1"
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.02,), daemon=True)

    @property
    def written(self) -> int:
        return int(self._server.written)  # type: ignore[attr-defined]

    def _answer(self, handler: _Handler, got: Got) -> None:
        with self._lock:
            turn = self._turns[min(len(self.got), len(self._turns) - 1)]
            self.got.append(got)
        turn(handler, got)

    def __enter__(self) -> ChatServer:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._server.closing.set()  # type: ignore[attr-defined]
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


class _Handler(BaseHTTPRequestHandler):
    def do_POST(self) -> None:
        body = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
        # The client may have had enough.
        with contextlib.suppress(BrokenPipeError, ConnectionResetError):
            self.server.answer(self, Got(self.path, dict(self.headers), body))  # type: ignore[attr-defined]
        self.close_connection = True

    def head(self, code: int, headers: dict[str, str]) -> None:
        self.send_response(code)
        for name, value in headers.items():
            self.send_header(name, value)
        self.end_headers()

    def send(self, code: int, body: bytes, headers: dict[str, str] | None = None) -> None:
        self.head(
            code, {"Content-Length": str(len(body)), "Content-Type": "application/json", **(headers or {})}
        )
        self.wfile.write(body)

    def log_message(self, format: str, *args: Any) -> None:
        pass
