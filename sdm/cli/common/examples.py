"""Examples at the end of each command's help. A test parses every one of them."""

from __future__ import annotations

from collections.abc import Sequence

# The words after `sdm` that a help text belongs to -> command lines.
EXAMPLES: dict[str, tuple[str, ...]] = {
    "inspect": ("sdm inspect bunny.ply", "sdm inspect bunny.ply --json"),
    "compute": (
        "sdm compute bunny.ply -o bunny.nii.gz --resolution 256",
        "sdm compute meshes -o maps --spacing 0.5 --resume --skip-bad",
        "sdm compute soup.obj -o soup.npz --sign flood --hole-size 2.0",
        "sdm compute bunny.ply -o band.nvdb --resolution 1024 --band 3",
    ),
    "edt": (
        "sdm edt organs.nii.gz -o maps.nii.gz",
        "sdm edt organs.nii.gz -o liver.nii.gz --classes 6 --smooth 1.0",
        "sdm edt labels -o maps --format npz",
    ),
    "surface": (
        "sdm surface bunny.nii.gz -o bunny.ply",
        "sdm surface organs.nii.gz -o liver.stl --label 6 --smooth 1.0",
        "sdm surface maps -o meshes --format obj",
    ),
    "watertight": (
        "sdm watertight soup.obj -o closed.ply",
        "sdm watertight meshes -o closed --resolution 256 --resume",
    ),
    "generate": (
        "sdm generate cochlea -o cochlea.zarr --count 1000 --resolution 64",
        "sdm generate meshes -o shapes.zarr --count 1000 --seed 1",
        "sdm generate -o cochlea.zarr --resume",
    ),
    "sample": (
        "sdm sample meshes -o samples",
        "sdm sample meshes -o samples --layout occupancy --count 200000 --seed 1",
    ),
    "split": ("sdm split meshes", "sdm split meshes --val 0.1 --test 0.2 --group '^[^/]+'"),
    "family check": ("sdm family check cochlea", "sdm family check shapes.py:Torus --count 200"),
    "family show": ("sdm family show cochlea -o cochlea.png",),
    "shape-model build": ("sdm shape-model build atria -o atria.npz",),
    "shape-model show": ("sdm shape-model show atria.npz -o atria.png",),
    "shape-model import": ("sdm shape-model import femur.pc.npz --mean femur.ply -o femur.npz",),
    "train deepsdf": ("sdm train deepsdf meshes -o model --budget-s 600",),
    "train sdmnn": (
        "sdm train sdmnn -o surrogate --family shapes.py:Torus --budget-s 300",
        "sdm train sdmnn -o networks --budget-s 3600",
    ),
    "train segmentation": ("sdm train segmentation --data cases -o network --method boundary",),
    "predict": (
        "sdm predict -o cochlea.nii.gz --a 3.6 --alpha 0.3 --b 0.139 --phi -0.17",
        "sdm predict -o torus.npz --model surrogate --set radius=1.0 tube=0.3",
    ),
    "fit": (
        "sdm fit scan.nii.gz -o fit.json --mesh fit.ply --picture fit.png",
        "sdm fit --points scan.npy -o fit.json --family atria.npz",
    ),
    "encode": ("sdm encode patient.ply -m model -o patient.npz",),
    "decode": ("sdm decode patient.npz -m model -o patient.ply", "sdm decode a.npz -m model -o strip.png --to b.npz"),
    "segment": ("sdm segment scan.nii.gz -m network/model.pt -o labels",),
    "evaluate": (
        "sdm evaluate predicted.nii.gz truth.nii.gz",
        "sdm evaluate labels truths --json scores.json",
    ),
    "view": ("sdm view bunny.nii.gz", "sdm view bunny.ply --out bunny.png"),
    "explore": (
        "sdm explore",
        "sdm explore bunny.ply --port 8090",
        "sdm explore cochlea --stream",
        "sdm explore --fit scan.nii.gz",
    ),
    "demo": ("sdm demo", "sdm demo --resolution 64 --out demo"),
    "doctor": ("sdm doctor", "sdm doctor --compile --device cpu"),
    "completion": (
        "sdm completion bash > ~/.local/share/bash-completion/completions/sdm",
        "sdm completion zsh > ~/.zfunc/_sdm",
    ),
    "bench": ("sdm bench --quick", "sdm bench --meshes bunny.ply --resolutions 64 128 --peers sdm libigl -o results"),
}


def of_help(words: Sequence[str]) -> str:
    """Examples to print after the help that `words` asked for; empty if there are none."""
    names = [word for word in words if not word.startswith("-")]
    found = EXAMPLES.get(" ".join(names[:2])) or EXAMPLES.get(names[0] if names else "", ())
    return "\nExamples:\n" + "".join(f"  {line}\n" for line in found) if found else ""
