"""Signed distance maps of all classes of a label image in one call, as targets of a segmentation network."""

import matplotlib.pyplot as plt
import torch

import sdm
from sdm.viz import STYLE, colour_map

# A label image: three balls that touch, in voxels of 1 x 1 x 2 mm.
spacing, shape = (1.0, 1.0, 2.0), (72, 72, 36)
x, y, z = torch.meshgrid(*(s * torch.arange(n) for s, n in zip(spacing, shape, strict=True)), indexing="ij")
labels = torch.zeros(shape, dtype=torch.uint8)
for label, (centre, radius) in enumerate({(24, 28, 36): 16.0, (50, 30, 36): 12.0, (36, 52, 36): 11.0}.items(), 1):
    inside = (x - centre[0]) ** 2 + (y - centre[1]) ** 2 + (z - centre[2]) ** 2 < radius**2
    labels[inside & (labels == 0)] = label

maps = sdm.euclidean_distance_transform(labels, classes=[1, 2, 3], signed=True, spacing=spacing)
print(f"labels {tuple(labels.shape)} -> maps {tuple(maps.shape)} in mm, negative inside")
assert torch.equal(maps < 0, torch.stack([labels == c for c in (1, 2, 3)]))

plt.rcParams.update(STYLE)
figure, axes = plt.subplots(1, 4, figsize=(10, 2.8), layout="constrained")
middle = shape[2] // 2
axes[0].imshow(labels[:, :, middle].T.numpy(), origin="lower", cmap="viridis")
axes[0].set_title("labels")
for c, ax in enumerate(axes[1:]):
    values = maps[c, :, :, middle].T.cpu().numpy()
    drawn = ax.imshow(values, origin="lower", cmap=colour_map(), vmin=-20, vmax=20)
    ax.contour(values, levels=[0], colors="k", linewidths=1.5)
    ax.set_title(f"class {c + 1}")
for ax in axes:
    ax.axis("off")
figure.colorbar(drawn, ax=axes[-1], label="distance [mm]")
figure.savefig("many_classes.png", dpi=100)
