"""The exceptions of iclk."""

from __future__ import annotations


class Error(Exception):
    """An error whose message names the value and the remedy. A failed alignment is not an error; it has a status.

    ``code``: "invalid_argument", "unsupported", "no_driver", "no_device", "out_of_memory", "device_lost", "vulkan" or "io".
    """

    def __init__(self, code: str, message: str) -> None:
        super().__init__(code, message)
        self.code = code

    def __str__(self) -> str:
        return str(self.args[1])


class InvalidArgument(Error, ValueError):
    """An invalid argument; ``except ValueError`` catches it too. ``code`` is "invalid_argument"."""
