"""A dataset on disk that holds, bit for bit, what the stream would have given."""

import shutil

import matplotlib.pyplot as plt
import torch
from torch.utils.data import DataLoader

import sdm
from sdm.dataset import freeze
from sdm.viz import STYLE, colour_map

family = sdm.shapes.make_family("geometric-shapes")
stream = sdm.SDMStream(family, family.grid(24), batch_size=8, seed=1)

shutil.rmtree("shapes.zarr", ignore_errors=True)
freeze(stream, 16, "shapes.zarr")

data = sdm.SDMDataset("shapes.zarr")
theta, maps, index = data[5]
assert torch.equal(maps, stream.sample([5]).sdm[0].cpu().reshape(maps.shape))
print(f"{len(data)} samples; number 5 is the stream's own, bit for bit")

theta, maps, index = next(iter(DataLoader(data, batch_size=16, shuffle=True)))
plt.rcParams.update(STYLE)
figure, axes = plt.subplots(2, 8, figsize=(10, 2.7), layout="constrained")
limit = float(maps.abs().max()) / 2
for ax, values, number in zip(axes.flat, maps, index, strict=True):
    middle = values.reshape(24, 24, 24)[:, :, 12].T.numpy()
    ax.imshow(middle, origin="lower", cmap=colour_map(), vmin=-limit, vmax=limit)
    ax.contour(middle, levels=[0], colors="k", linewidths=1.5)
    ax.set_title(f"sample {int(number)}", fontsize=8)
    ax.axis("off")
figure.savefig("freeze_a_dataset.png", dpi=100)
