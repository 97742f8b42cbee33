"""Errors and warnings that are the user's to mend: one sentence that says what is wrong, where, and what to do."""


class SDMError(ValueError):
    """Base of every error that bad input causes; the commands print it and exit with code 2."""


class MeshError(SDMError):
    """A mesh that cannot be used: no triangles, NaN vertices, a face index out of range, an unreadable file."""


class GridError(SDMError):
    """A grid that cannot be used: no voxels, a spacing that is not positive, more memory than there is."""


class DeviceError(SDMError):
    """A device that is not there."""


class FormatError(SDMError):
    """A file that cannot be read or written in the format that was requested."""


class SDMWarning(UserWarning):
    """A result that is probably not what was meant: a mesh inside out, or in another unit than its grid."""


# Characters of another library's message that a sentence has room for.
_LONGEST = 200


def one_line(message: object) -> str:
    """Another library's message, fit for the middle of a sentence: on one line, cut where it grows long.

    Of an error without one, its name.
    """
    text = " ".join(str(message).split()).rstrip(".")
    if not text and isinstance(message, BaseException):
        text = type(message).__name__
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}..."
