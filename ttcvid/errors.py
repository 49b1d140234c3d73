"""Known failures: each becomes one line on stderr and an exit code, never a traceback."""


class TtcvidError(Exception):
    """Root of every failure that a user can mend.

    The message is one line that names file, field, value, what was expected and the remedy.
    """

    exit_code = 2


class UsageError(TtcvidError):
    """An option, argument, configuration value or output place cannot be used as given."""

    exit_code = 2


class OutputError(TtcvidError):
    """A result cannot be written: the place exists, is not writable, or the disk is full."""

    exit_code = 2


class InputError(TtcvidError):
    """The clip, image folder or track table cannot be read."""

    exit_code = 3


class CalibrationError(TtcvidError):
    """A camera, horizon or mask file cannot be read or does not fit the clip."""

    exit_code = 3


class UndeterminedError(TtcvidError):
    """What was asked for cannot be told from this input: too little in it, or nothing that fits."""

    exit_code = 5


class NotComparableError(TtcvidError):
    """A result or baseline cannot be compared: it is unreadable, not whole, or of another schema."""

    exit_code = 2
