"""A CNN trained on a stream that never ends: maps of shapes as a coarse scan would give them, made fine again."""

import itertools

import matplotlib.pyplot as plt
import torch
from torch import nn
from torch.nn.functional import avg_pool3d, interpolate

import sdm
from sdm.viz import STYLE, colour_map

STEPS, BATCH = 100, 4

family = sdm.shapes.GeometricShapes(triangles=300)  # cuboids, rhomboids, ellipsoids and cylinders
grid = family.grid(24)
stream = sdm.SDMStream(family, grid, batch_size=BATCH, seed=0)


def coarse(maps: torch.Tensor) -> torch.Tensor:
    """Means of 4^3 voxels, noise of half a voxel, and the fine grid again without new detail."""
    small = avg_pool3d(maps, 4)
    small = small + 0.5 * grid.spacing[0] * torch.randn_like(small)
    return interpolate(small, size=maps.shape[2:], mode="trilinear")


torch.manual_seed(0)
net = nn.Sequential(
    nn.Conv3d(1, 16, 4, stride=2, padding=1), nn.SiLU(), nn.Conv3d(16, 32, 3, padding=1), nn.SiLU(),
    nn.Conv3d(32, 16, 3, padding=1), nn.SiLU(), nn.ConvTranspose3d(16, 1, 4, stride=2, padding=1),
).to(stream.device)  # fmt: skip
optimizer = torch.optim.Adam(net.parameters(), 3e-3)
losses = []
for _, maps, _ in itertools.islice(stream, STEPS):  # no shape comes twice
    given = coarse(maps)
    loss = (given + net(given) - maps).abs().mean() / grid.spacing[0]
    optimizer.zero_grad()
    loss.backward()
    optimizer.step()
    losses.append(loss.detach())

held_out = stream.validation(8).sdm  # shapes that no stream gives
with torch.no_grad():
    given = coarse(held_out)
    found = given + net(given)
before, after = (float((maps - held_out).abs().mean()) / grid.spacing[0] for maps in (given, found))
print(f"shapes never seen: {before:.2f} voxels off before the network, {after:.2f} after")

plt.rcParams.update(STYLE)
figure, axes = plt.subplots(1, 4, figsize=(12, 3.2), layout="constrained", width_ratios=(1.4, 1, 1, 1))
axes[0].plot(torch.stack(losses).cpu().numpy(), label="by the network, in training")
axes[0].axhline(before, color="0.6", label="as given")
axes[0].set(xlabel="step", ylabel="mean error [voxels]", ylim=(0, None), title="Every step has new shapes")
axes[0].legend()
largest = int((held_out < 0).sum((1, 2, 3, 4)).argmax())
for ax, name, maps in zip(axes[1:], ("exact", "as given", "by the network"), (held_out, given, found), strict=True):
    middle = maps[largest, 0, :, :, 12].T.cpu().numpy() / grid.spacing[0]
    shown = ax.imshow(middle, origin="lower", cmap=colour_map(), vmin=-6, vmax=6)
    ax.contour(middle, levels=[0], colors="k", linewidths=1.5)
    ax.set(title=name, xticks=[], yticks=[])
figure.colorbar(shown, ax=axes[-1], label="signed distance [voxels]", extend="both")
figure.savefig("cnn_on_the_stream.png", dpi=100)
