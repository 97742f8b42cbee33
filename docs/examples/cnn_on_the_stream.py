"""A CNN that learns a turned cylinder's size from its distance map, on a stream that never repeats a shape."""

import itertools

import matplotlib.pyplot as plt
import torch
from torch import nn

import sdm

STEPS, BATCH, RESOLUTION = 200, 16, 16

family = sdm.shapes.make_family("cylinder", triangles=500)
grid = family.grid(RESOLUTION)
device = "cuda" if torch.cuda.is_available() else "cpu"
stream = sdm.SDMStream(family, grid, batch_size=BATCH, seed=0, device=device)

channels = (1, 16, 32, 64)
layers = [
    layer
    for ins, outs in itertools.pairwise(channels)
    for layer in (nn.Conv3d(ins, outs, 3, stride=2, padding=1), nn.SiLU())
]
net = nn.Sequential(*layers, nn.Flatten(), nn.LazyLinear(2)).to(device)
scale = float(grid.spacing[0]) * RESOLUTION / 2


def sizes(theta: torch.Tensor) -> torch.Tensor:
    """Radius and half-length, of ranges that go from 0 to 1; the turn about a random axis is what the network must ignore."""
    return family.to_unit(theta)[:, :2]


held_out = stream.validation(64)
theta, maps = (t.to(device) for t in (held_out.theta, held_out.sdm))
net(maps / scale)  # the lazy layer takes its size
optimizer = torch.optim.AdamW(net.parameters(), 2e-3)
losses = []
for batch in itertools.islice(stream, STEPS):
    loss = nn.functional.mse_loss(net(batch.sdm / scale), sizes(batch.theta))
    optimizer.zero_grad()
    loss.backward()
    optimizer.step()
    losses.append(loss.item())
with torch.no_grad():
    error = (net(maps / scale) - sizes(theta)).abs().mean()
print(f"radius and length of cylinders never seen: {100 * float(error):.1f} % of their range off, on average")

figure, axes = plt.subplots(figsize=(6, 3.5), layout="constrained")
axes.semilogy(losses)
axes.set(xlabel="step", ylabel="mean squared error", title="Every batch is of new shapes")
figure.savefig("cnn_on_the_stream.png", dpi=100)
