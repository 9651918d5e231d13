"""Messages with a sound envelope around whatever body."""

import zlib

from ttus_opt.message.envelope import CHECKSUM, HEAD, MARK, VERSION


def body(message):
    return message[HEAD.size : -CHECKSUM.size]


def sealed(content, kind, version=VERSION):
    """A message whose length and checksum are right."""
    length = HEAD.size + len(content) + CHECKSUM.size
    head = HEAD.pack(MARK, version, kind, length) + content
    return head + CHECKSUM.pack(zlib.crc32(head))
