"""A CNN trained on a stream that never ends: maps of cochleas as a coarse scan would have them, made fine again."""

import itertools

import matplotlib.pyplot as plt
import torch
from torch import nn
from torch.nn.functional import avg_pool3d, interpolate

import sdm
from sdm.viz import STYLE, colour_map

STEPS, BATCH = 100, 4

family = sdm.shapes.Cochlea(triangles=1_000)
stream = sdm.SDMStream(family, family.grid(24), batch_size=BATCH, seed=0)


def coarse(maps: torch.Tensor) -> torch.Tensor:
    """Means of 4^3 voxels, noise, and back to the fine grid without new detail."""
    small = avg_pool3d(maps, 4)
    return interpolate(small + 0.05 * torch.randn_like(small), size=maps.shape[2:], mode="trilinear")


torch.manual_seed(0)
net = nn.Sequential(
    nn.Conv3d(1, 8, 3, padding=1), nn.SiLU(), nn.Conv3d(8, 8, 3, padding=2, dilation=2), nn.SiLU(),
    nn.Conv3d(8, 8, 3, padding=4, dilation=4), nn.SiLU(), nn.Conv3d(8, 1, 3, padding=1),
).to(stream.device)  # fmt: skip
optimizer = torch.optim.Adam(net.parameters(), 3e-3)
losses = []
for _, maps, _ in itertools.islice(stream, STEPS):  # no shape comes twice
    given = coarse(maps)
    loss = (given + net(given) - maps).abs().mean()
    optimizer.zero_grad()
    loss.backward()
    optimizer.step()
    losses.append((loss.detach(), (given - maps).abs().mean()))

held_out = stream.validation(8).sdm  # shapes that no stream gives
with torch.no_grad():
    given = coarse(held_out)
    found = given + net(given)
before, after = (float((maps - held_out).abs().mean()) for maps in (given, found))
print(f"shapes never seen: {before:.3f} mm off before the network, {after:.3f} mm after")

plt.rcParams.update(STYLE)
figure, axes = plt.subplots(1, 4, figsize=(12, 3.2), layout="constrained", width_ratios=(1.5, 1, 1, 1))
ours, nothing = torch.tensor(losses).T
axes[0].semilogy(ours, label="by the network")
axes[0].semilogy(nothing, color="0.6", label="as given")
axes[0].set(xlabel="step", ylabel="mean error [mm]", title="Every step has new shapes")
axes[0].legend()
for ax, name, maps in zip(axes[1:], ("exact", "as given", "by the network"), (held_out, given, found), strict=True):
    middle = maps[0, 0, :, :, 12].T.cpu()
    shown = ax.imshow(middle, origin="lower", cmap=colour_map(), vmin=-1, vmax=1)
    ax.contour(middle, levels=[0], colors="k", linewidths=1.5)
    ax.set(title=name, xticks=[], yticks=[])
figure.colorbar(shown, ax=axes[-1], label="signed distance [mm]", extend="both")
figure.savefig("cnn_on_the_stream.png", dpi=100)
