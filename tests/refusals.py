"""A refusal in one line: the package's own error, one line long, with certain words."""

from collections.abc import Callable

import pytest

from ttus_opt.core.errors import TtusError


def refuses(
    error: type[TtusError] | tuple[type[TtusError], ...],
    words: str,
    call: Callable[..., object],
    /,
    *given: object,
    **options: object,
) -> str:
    """The call raises this error; returns its message.

    Args:
        error: Class of the error.
        words: Pattern that its message holds; "" for any.
        call: What is refused.
        given: Its arguments.
        options: Its named ones.
    """
    with pytest.raises(error, match=words or None) as told:
        call(*given, **options)
    message = str(told.value)
    assert "\n" not in message, "a message is one line"
    return message
