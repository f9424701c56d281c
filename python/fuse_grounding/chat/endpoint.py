"""One HTTP request to a chat-completions endpoint, repeated where that can help, within stated limits.

Over urllib3, which has no dependencies and lets a body be read in pieces. The `openai` package was the other
choice: it reads a reply of any size, has no limit on the time of a question with all its attempts, and takes
addresses and keys from environment variables that no setting names.
"""

from __future__ import annotations

import os
import random
import time
import urllib.request
from typing import Any
from urllib.parse import urlsplit

from fuse_grounding.config_chat import ChatConfig
from fuse_grounding.errors import FuseError, UnusableError
from fuse_grounding.extras import require

AGAIN = (408, 409, 425, 429)
"""Statuses below 500 after which another attempt may succeed."""
LONGEST_WAIT_S = 30.0
_BLOCK, _ERROR_BYTES, _SHOWN = 1 << 16, 1 << 14, 300


class NoReply(FuseError):
    """A question stayed without a usable reply, though the endpoint is there."""


class Refused(UnusableError):
    """The server takes no such request (400 or 422)."""


class _Again(Exception):
    """An attempt that may be repeated, after `wait_s` where the server said so; `gone`: nobody was there."""

    def __init__(self, what: str, wait_s: float | None = None, gone: bool = False):
        super().__init__(what)
        self.what, self.wait_s, self.gone = what, wait_s, gone


class Endpoint:
    """POSTs JSON to `base_url`/chat/completions."""

    def __init__(self, config: ChatConfig, section: str):
        """`section` names the settings in messages. Raises UnusableError without urllib3 or key."""
        self._config, self._section = config, section
        self._urllib3: Any = require("urllib3", "llm", f"`{section}` (a language model)")
        self._url = f"{config.base_url}/chat/completions"
        self._pool = self._open_pool()
        self._key()
        self._reached = False

    def post(self, body: bytes) -> bytes:
        """The body of the reply with status 200, at most `max_reply_bytes`.

        Raises UnusableError where no attempt can help: nobody there, wrong key, no such model, a request that
        the server does not take (`Refused`). Raises NoReply where attempts or time ran out, and for a reply
        that is too long.
        """
        deadline = time.monotonic() + self._config.total_s
        wait, attempts = self._config.backoff_s, self._config.retries + 1
        for attempt in range(1, attempts + 1):
            try:
                return self._attempt(body, deadline)
            except _Again as failure:
                last = failure
            kind = UnusableError if last.gone else NoReply
            if attempt == attempts:
                raise kind(f"{self._where}: {last.what}, at the last of {attempts} attempts")
            pause = wait * random.uniform(0.5, 1.0) if last.wait_s is None else last.wait_s
            wait = min(2 * wait, LONGEST_WAIT_S)
            if time.monotonic() + pause > deadline:
                asked = "" if last.wait_s is None else f", and asks to wait {last.wait_s:.0f} s"
                limit = f"`{self._section}.total_s` is {self._config.total_s:g}"
                raise kind(f"{self._where}: {last.what}{asked}; {limit}")
            time.sleep(pause)
        raise AssertionError("the last attempt returns or raises")

    @property
    def _where(self) -> str:
        return f"{self._section} at {self._config.base_url}"

    def _attempt(self, body: bytes, deadline: float) -> bytes:
        errors = self._urllib3.exceptions
        left = max(0.01, min(self._config.timeout_s, deadline - time.monotonic()))
        stop = time.monotonic() + left
        try:
            response = self._pool.urlopen(
                "POST",
                self._url,
                body=body,
                headers=self._headers(),
                timeout=self._urllib3.Timeout(connect=left, read=left),
                retries=False,
                redirect=False,
                preload_content=False,
            )
        except (errors.NewConnectionError, errors.SSLError, errors.ProxyError) as error:
            if self._reached:  # it was there a moment ago
                raise _Again(f"nobody answers any more ({_cause(error)})", gone=True) from None
            raise UnusableError(
                f"{self._where}: nobody answers ({_cause(error)}); is the server running, and is "
                f"`{self._section}.base_url` right?"
            ) from None
        except errors.TimeoutError:
            raise _Again(f"no reply within {self._config.timeout_s:g} s") from None
        except errors.HTTPError as error:
            raise _Again(f"the connection broke off ({_cause(error)})") from None
        self._reached = True
        try:
            if response.status != 200:
                self._refuse(response, stop)
            return self._read(response, self._config.max_reply_bytes, stop)
        except errors.TimeoutError:
            raise _Again(f"no reply within {self._config.timeout_s:g} s") from None
        except errors.HTTPError as error:
            raise _Again(f"the reply broke off ({_cause(error)})") from None
        finally:
            response.close()

    def _read(self, response: Any, most: int, stop: float) -> bytes:
        """The whole body. `read1` returns what has come in, so that a trickle cannot outlast `stop`."""
        taken = bytearray()
        while block := response.read1(_BLOCK):
            taken += block
            if len(taken) > most:
                raise NoReply(f"{self._where}: the reply is longer than {most} bytes; the rest was not read")
            if time.monotonic() > stop:
                raise _Again(f"no whole reply within {self._config.timeout_s:g} s")
        return bytes(taken)

    def _refuse(self, response: Any, stop: float) -> None:
        """Raises what a status other than 200 means."""
        status = response.status
        try:
            text = self._read(response, _ERROR_BYTES, stop).decode(errors="replace")
        except NoReply:
            text = ""
        said = self._said(text)
        if status in AGAIN or status >= 500:
            raise _Again(f"the server says {status}{said}", self._retry_after(response))
        if status in (401, 403):
            variable = self._config.key_env
            which = f"the key in {variable} is refused" if variable else "a key is wanted, and none was sent"
            hint = "" if variable else f"; `{self._section}.key_env` names the variable that holds it"
            raise UnusableError(f"{self._where}: {which} ({status}{said}){hint}")
        if status in (400, 422):
            raise Refused(f"{self._where}: the server does not take the request ({status}{said})")
        if 300 <= status < 400:
            location = _short(response.headers.get("Location", "nowhere"))
            raise UnusableError(
                f"{self._where}: the server redirects to {location}; name that address itself"
            )
        if status == 404:
            raise UnusableError(
                f"{self._where}: no such address or model `{self._config.model}` (404{said}); most addresses "
                "end in /v1"
            )
        raise UnusableError(f"{self._where}: the server says {status}{said}")

    def _said(self, text: str) -> str:
        """The server's own words, short, without the key where it repeats that."""
        key = self._key()
        return f": {_short(text.replace(key, '[key]') if key else text)}" if text.strip() else ""

    def _retry_after(self, response: Any) -> float | None:
        """Seconds by the header Retry-After, as a number or a date; None without one that can be read."""
        try:
            return self._urllib3.Retry().get_retry_after(response)
        except self._urllib3.exceptions.InvalidHeader:
            return None

    def _headers(self) -> dict[str, str]:
        headers = {"Content-Type": "application/json", "Accept": "application/json"}
        if key := self._key():
            headers["Authorization"] = f"Bearer {key}"
        return headers

    def _key(self) -> str:
        """Raises UnusableError where the variable is missing or cannot be sent."""
        variable = self._config.key_env
        if not variable:
            return ""
        key = os.environ.get(variable, "").strip()
        if not key:
            raise UnusableError(f"`{self._section}.key_env`: the environment variable {variable} is not set")
        if not (key.isascii() and key.isprintable()):
            raise UnusableError(f"`{self._section}.key_env`: {variable} holds characters that no key has")
        return key

    def _open_pool(self) -> Any:
        """Through the proxy that the environment names for this host, if any; never for this machine."""
        parts = urlsplit(self._config.base_url)
        host = parts.hostname or ""
        proxy = urllib.request.getproxies().get(parts.scheme)
        if proxy and host not in ("localhost", "127.0.0.1", "::1") and not urllib.request.proxy_bypass(host):
            return self._urllib3.ProxyManager(proxy)
        return self._urllib3.PoolManager()


def _cause(error: Exception) -> str:
    """The last words of urllib3's message, which begins with an object's address."""
    reason = getattr(error, "reason", None) or error
    return _short(str(reason).rsplit(">: ", 1)[-1].rsplit("): ", 1)[-1])


def _short(text: str) -> str:
    flat = " ".join("".join(c if c.isprintable() else " " for c in text).split())
    return flat if len(flat) <= _SHOWN else f"{flat[:_SHOWN]}…"
