"""Recipe of a folder of samples: all that they depend on besides the meshes, kept beside them."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path

from sdm.core.normalization import Normal
from sdm.engine.arguments import Orient, Sign
from sdm.errors import FormatError
from sdm.io.files.atomic import put
from sdm.sampling.law import SampleLaw

NAME, VERSION = "sampling.json", 1


@dataclass(frozen=True, kw_only=True)
class Recipe:
    """Arguments of `sdm.sampling.sample` that are the same for all meshes, and the layout's name."""

    layout: str
    law: SampleLaw
    count: int
    normalize: Normal | None
    seed: int
    sign: Sign = "winding"
    hole_size: float | None = None
    closest: bool = False
    open_meshes: str = "reject"
    orient: Orient = "auto"

    def claim(self, folder: Path, names: list[str], parts: dict[str, list[int]] | None = None, *, resume: bool) -> None:
        """Write the recipe into a folder, or see that the one that is there is this.

        Args:
            folder: The folder.
            names: Paths of the meshes.
            parts: Part of their split -> numbers of its meshes, whose lists the recipe holds.
            resume: Go on with samples that are there.

        Raises:
            FormatError: The folder holds samples, and another recipe, other meshes, or nobody asked to go on.
        """
        lists = {part: [names[number] for number in own] for part, own in (parts or {}).items()}
        content = {"version": VERSION, **asdict(self), "meshes": names, **({"parts": lists} if lists else {})}
        wanted = json.loads(json.dumps(content))
        path = folder / NAME
        if not path.exists():
            folder.mkdir(parents=True, exist_ok=True)
            put(path, (json.dumps(wanted, indent=1) + "\n").encode())
            return
        try:
            # Recipes of before say nothing about faces.
            found = {"orient": "auto", **json.loads(path.read_text())}
        except (OSError, ValueError, TypeError):
            raise FormatError(f"{path} is damaged: remove the folder, and sample again") from None
        if not resume:
            raise FormatError(f"{folder} holds samples already: --resume goes on with them, or choose another name")
        differ = [key for key in wanted if found.get(key) != wanted[key]]
        if differ:
            raise FormatError(
                f"{folder} holds samples of another {' and '.join(differ)}: ask for the same, or choose another name"
            )
