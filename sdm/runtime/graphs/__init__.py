"""CUDA graphs: calls that come again and again are recorded once and replayed, one launch instead of dozens.

A map takes about 60 launches, which take the host longer than a GPU needs to run many of them. So the third call of one
kind (the same grid, numbers of meshes, vertices, faces and boundary edges, on one device) is recorded as a CUDA graph,
and those that follow copy their tensors into the recording's, launch it and copy the result out. What one recording
serves whatever its counts (`sdm.engine.capacity`) is recorded at the first call, which it serves too, and takes no
copies: a table in pinned memory tells it where tensors are. The values are the same bits. Calls
that want gradients, those inside `torch.compile` or another graph's capture, and results larger than 512 MiB are not
recorded.

A recording that has to go before it was used often makes later ones wait for more calls, so that many kinds by turns
cost little. Of each device the 32 used last of one kind are kept, and as many of those that serve many, with at most a
sixteenth of its memory; they share their scratch, so the device runs one after the other, whatever streams they are
launched on. `enable(False)`, or the environment variable `SDM_CUDA_GRAPHS=0`, turns this off, `paused()` for a while;
`clear()` gives the memory back.

For the library: `run` is the one entrance, and `speculate` the one for calls whose work rests on a guess.
"""

from sdm.runtime.graphs.captured_call import Verify, Work, unverified
from sdm.runtime.graphs.graph_cache import CALLS, Kept
from sdm.runtime.graphs.replay import (
    PATIENCE,
    Call,
    TableCall,
    TableWork,
    attempt,
    attempt_by_table,
    attempt_kept,
    clear,
    enable,
    is_recorded,
    kept,
    last_launch,
    note,
    paused,
    run,
    speculate,
    supports,
)

__all__ = [
    "CALLS",
    "PATIENCE",
    "Call",
    "Kept",
    "TableCall",
    "TableWork",
    "Verify",
    "Work",
    "attempt",
    "attempt_by_table",
    "attempt_kept",
    "clear",
    "enable",
    "is_recorded",
    "kept",
    "last_launch",
    "note",
    "paused",
    "run",
    "speculate",
    "supports",
    "unverified",
]
