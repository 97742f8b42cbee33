"""Distance maps of three classes inside a MONAI pipeline, of labels that it has just turned, scaled and bent."""

import matplotlib.pyplot as plt
import torch
from monai.data.meta_tensor import MetaTensor
from monai.transforms import Compose, Rand3DElasticd, RandAffined
from monai.utils.misc import set_determinism

from sdm.monai import SignedDistanceMapd
from sdm.viz import STYLE, colour_map

# A label image: three balls that touch, in voxels of 1 x 1 x 2 mm, and an image of them.
spacing, shape = (1.0, 1.0, 2.0), (72, 72, 36)
x, y, z = torch.meshgrid(*(s * torch.arange(n) for s, n in zip(spacing, shape, strict=True)), indexing="ij")
labels = torch.zeros(1, *shape)
for label, (centre, radius) in enumerate({(24, 28, 36): 16.0, (50, 30, 36): 12.0, (36, 52, 36): 11.0}.items(), 1):
    inside = (x - centre[0]) ** 2 + (y - centre[1]) ** 2 + (z - centre[2]) ** 2 < radius**2
    labels[0, inside & (labels[0] == 0)] = label
affine = torch.diag(torch.tensor([*spacing, 1.0]))
sample = {
    "image": MetaTensor(labels + 0.3 * torch.randn(labels.shape), affine=affine),
    "label": MetaTensor(labels, affine=affine),
}

both, modes = ["image", "label"], ["bilinear", "nearest"]
pipeline = Compose(
    [
        RandAffined(both, prob=1.0, rotate_range=(0.0, 0.0, 0.6), scale_range=0.15, mode=modes, padding_mode="zeros"),
        Rand3DElasticd(both, (4, 6), (40, 80), prob=1.0, mode=modes, padding_mode="zeros"),
        # Last, so that the maps are those of the labels as they are now; spacing comes with the label.
        SignedDistanceMapd("label", classes=[1, 2, 3], truncate=20.0),
    ]
)
set_determinism(0)
draws = [pipeline(sample) for _ in range(3)]
print(f"label {tuple(draws[0]['label'].shape)} -> label_sdm {tuple(draws[0]['label_sdm'].shape)} in mm")

plt.rcParams.update(STYLE)
figure, axes = plt.subplots(len(draws), 4, figsize=(9, 6.4), layout="constrained")
for row, drawn in zip(axes, draws, strict=True):
    middle = shape[2] // 2
    row[0].imshow(drawn["image"][0, :, :, middle].T.numpy(), origin="lower", cmap="gray")
    for c, ax in enumerate(row[1:]):
        values = drawn["label_sdm"][c, :, :, middle].T.numpy()
        shown = ax.imshow(values, origin="lower", cmap=colour_map(), vmin=-20, vmax=20)
        ax.contour(values, levels=[0], colors="k", linewidths=1.5)
        row[0].contour(values, levels=[0], colors=[f"C{c}"], linewidths=1.5)
for ax, title in zip(axes[0], ("image", "class 1", "class 2", "class 3"), strict=True):
    ax.set_title(title)
for ax in axes.flat:
    ax.axis("off")
figure.colorbar(shown, ax=axes[:, -1], label="distance [mm]", shrink=0.5)
figure.savefig("monai_pipeline.png", dpi=100)
