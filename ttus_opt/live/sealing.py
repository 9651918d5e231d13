"""Authenticated encryption of a session: nobody joins or reads it without its key.

Both sides have one key of 32 bytes. Each draws an X25519 key pair at its start and
sends the public half in a greeting, tagged with the session's key. Data are sealed by
ChaCha20-Poly1305 (RFC 8439) with keys from HKDF-SHA256 over the session's key, the
shared secret and both public keys, one for each direction, with a counter as nonce; the
pattern is that of Noise's NNpsk0 (T. Perrin, The Noise Protocol Framework, 2018). So

- without the session's key nothing can be read, made or changed;
- what was recorded cannot be read later with that key alone;
- packets of an earlier session do not open, and one of this session opens once;
- there is one version: nothing to fall back to.

All ciphers are those of the package `cryptography`.
"""

from __future__ import annotations

import os
import secrets
import stat
import struct
from pathlib import Path
from typing import Any

from ttus_opt.core import io
from ttus_opt.core.errors import FileError, InputError
from ttus_opt.core.optional import load
from ttus_opt.live.numbering import Once

#: Length of keys, and of the tag [bytes]
KEY, TAG = 32, 16

MARK, VERSION = b"TL", 1
GREETING, DATA = 0, 1
_HEAD, _COUNTER = struct.Struct("<2sBB"), struct.Struct("<Q")

#: Counters behind the newest that are still taken [–]
WINDOW = 1024


def new_key() -> bytes:
    """A random session key."""
    return secrets.token_bytes(KEY)


def write_key(path: Path) -> None:
    """Write a new session key as hexadecimal text, readable by its owner only.

    Raises:
        FileError: The file exists, or cannot be written.
    """
    if path.exists():
        raise FileError(f"{path} exists: a session key is never replaced")
    with io.replacing(path) as temporary:
        temporary.chmod(0o600)  # while it is empty
        temporary.write_text(new_key().hex() + "\n")


def read_key(path: Path) -> bytes:
    """A session key from a file.

    Raises:
        FileError: There is no such file, or no key in it, or it is one's own and others
            may read it, as ssh refuses a key.
    """
    file = io.existing_file(path, "session key")
    about = file.stat()
    own = hasattr(os, "getuid") and about.st_uid == os.getuid()
    if own and about.st_mode & (stat.S_IRWXG | stat.S_IRWXO):
        raise FileError(
            f"others may read the session key {file} (mode {about.st_mode & 0o777:o}): "
            f"chmod 600 {file}, and make a new one if somebody has"
        )
    try:
        key = bytes.fromhex(file.read_text().strip())
    except (ValueError, UnicodeDecodeError) as error:
        raise FileError(
            f"{file} holds no session key: ttus-opt live key makes one"
        ) from error
    if len(key) != KEY:
        raise FileError(f"{file} holds {len(key)} bytes, a session key has {KEY}")
    return key


def looks_sealed(data: bytes) -> bool:
    """Whether a packet begins like data of a channel."""
    return data.startswith(_HEAD.pack(MARK, VERSION, DATA))


class SealedChannel:
    """One side of an encrypted channel, without sockets.

    Attributes:
        ready: Whether keys are agreed, so that `seal` works.
        confirmed: Whether a packet of the other side has been opened.
        greetings: Greetings taken so far that want an answer, also again [–].
        refused: Packets refused so far [–].
    """

    def __init__(self, key: bytes, *, calls: bool, purpose: str = "datagrams") -> None:
        """A channel before the first greeting.

        Args:
            key: The session's key.
            calls: Whether this is the side that calls, the operator's.
            purpose: Channels of another purpose have other keys.

        Raises:
            InputError: A key of another length.
            MissingPackageError: cryptography is not installed.
        """
        if len(key) != KEY:
            raise InputError(f"a session key has {KEY} bytes, got {len(key)}")
        base = "cryptography.hazmat.primitives"
        exchange = load(f"{base}.asymmetric.x25519", "live")
        self._ciphers = load(f"{base}.ciphers.aead", "live").ChaCha20Poly1305
        self._kdf = load(f"{base}.kdf.hkdf", "live").HKDF
        self._sha = load(f"{base}.hashes", "live").SHA256
        self._public_of = exchange.X25519PublicKey.from_public_bytes
        self._key, self._calls, self._purpose = key, calls, purpose
        self._private = exchange.X25519PrivateKey.generate()
        self._public = self._private.public_key().public_bytes_raw()
        self._greets = self._derived(key, b"greeting")
        self._other = b""
        self._sends: Any = None
        self._opens: Any = None
        self._candidate: tuple[bytes, Any, Any] | None = None
        self._left: set[bytes] = set()  # public keys of processes that are gone
        self._counter, self._taken = 0, Once(WINDOW)
        self.confirmed, self.refused, self.greetings = False, 0, 0

    @property
    def ready(self) -> bool:
        """Whether keys are agreed."""
        return self._sends is not None

    def greeting(self) -> bytes:
        """What tells the other side this side's public key."""
        head = _HEAD.pack(MARK, VERSION, GREETING)
        nonce = self._public[:12]
        tag = self._greets.encrypt(nonce, b"", head + self._public + self._role(True))
        return bytes(head + self._public + tag)

    def seal(self, content: bytes) -> bytes:
        """An encrypted packet.

        Raises:
            InputError: No greeting of the other side has arrived yet.
        """
        if self._sends is None:
            raise InputError("the other side has not greeted yet")
        self._counter += 1
        head = _HEAD.pack(MARK, VERSION, DATA) + _COUNTER.pack(self._counter)
        return head + bytes(self._sends.encrypt(_nonce(self._counter), content, head))

    def open(self, data: bytes) -> bytes | None:
        """The content of a packet; None for a greeting and for what is refused."""
        if len(data) < _HEAD.size + TAG or data[:3] != MARK + bytes([VERSION]):
            self.refused += 1
            return None
        if data[3] == GREETING:
            self._greeted(data)
            return None
        content = self._opened(data) if data[3] == DATA else None
        if content is None:
            self.refused += 1
        return content

    def _role(self, own: bool) -> bytes:
        return b"caller" if self._calls is own else b"called"

    def _derived(self, secret: bytes, what: bytes) -> Any:
        info = b"ttus_opt live 1 " + self._purpose.encode() + b" " + what
        kdf = self._kdf(algorithm=self._sha(), length=KEY, salt=None, info=info)
        return self._ciphers(kdf.derive(secret))

    def _greeted(self, data: bytes) -> None:
        """Take a greeting: keys at once, or, once confirmed, as candidates."""
        public, tag = data[_HEAD.size : _HEAD.size + KEY], data[_HEAD.size + KEY :]
        held = self._candidate[0] if self._candidate else b""
        if len(public) != KEY or public in (self._other, held, *self._left):
            self.greetings += public == held  # its answer was lost
            return
        try:
            aad = data[: _HEAD.size] + public + self._role(False)
            self._greets.decrypt(public[:12], tag, aad)
            shared = self._private.exchange(self._public_of(public))
        except Exception:  # of cryptography: a wrong tag, a public key of small order
            self.refused += 1
            return
        self.greetings += 1
        both = self._public + public if self._calls else public + self._public
        secret = self._key + shared + both
        found = (
            public,
            self._derived(secret, self._role(True)),
            self._derived(secret, self._role(False)),
        )
        if self.confirmed:  # perhaps the replay of an old one: data will tell
            self._candidate = found
        else:
            self._adopt(found)

    def _adopt(self, found: tuple[bytes, Any, Any]) -> None:
        """Change keys. Who was confirmed and is replaced does not come back.

        The counter of what is sent goes on: keys that were left for a replayed greeting
        may be taken again, but no nonce twice.
        """
        if self.confirmed:
            self._left.add(self._other)
        self._other, self._sends, self._opens = found
        self._candidate, self._taken = None, Once(WINDOW)

    def _opened(self, data: bytes) -> bytes | None:
        head = data[: _HEAD.size + _COUNTER.size]
        if len(head) < _HEAD.size + _COUNTER.size:
            return None
        (counter,) = _COUNTER.unpack(head[_HEAD.size :])
        rest = data[len(head) :]
        content = None
        if self._opens is not None and counter not in self._taken:
            content = _tried(self._opens, counter, rest, head)
        if content is None and self._candidate is not None:
            content = _tried(self._candidate[2], counter, rest, head)
            if content is not None:
                self._adopt(self._candidate)
        if content is not None:
            self.confirmed = True
            self._taken.add(counter)
        return content


def _nonce(counter: int) -> bytes:
    return bytes(4) + _COUNTER.pack(counter)


def _tried(cipher: Any, counter: int, rest: bytes, head: bytes) -> bytes | None:
    """The content, or None where the tag is wrong."""
    from cryptography.exceptions import InvalidTag

    try:
        return bytes(cipher.decrypt(_nonce(counter), rest, head))
    except InvalidTag:
        return None
