"""Full disks: of what every further file would fail by, too."""

from __future__ import annotations

import errno

# A quota that is used up, and files that may not grow, are the same to who writes.
FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


def is_full_disk(error: BaseException | None) -> bool:
    """True if an error, or one that it came from, says that there is no room."""
    while error is not None:
        if isinstance(error, OSError) and error.errno in FULL:
            return True
        error = error.__cause__
    return False
