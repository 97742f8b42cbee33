"""A family of shapes of your own, and a network that gives its maps without a mesh, trained on its endless stream."""

import itertools
import math
from pathlib import Path

import torch
from torch import nn

import sdm
from sdm.shapes import Family, Parameter
from sdm.viz.side_by_side import side_by_side

STEPS, BATCH, RESOLUTION = 200, 8, 16


class Torus(Family):
    """Tori about z: `R` from the axis to the tube's centre, `r` the tube's radius."""

    name = "torus"
    parameters = (Parameter("R", 2.0, 3.0, "mm"), Parameter("r", 0.3, 0.9, "mm"))

    def __init__(self, around: int = 32, across: int = 16) -> None:
        i, j = (
            index.reshape(-1) for index in torch.meshgrid(torch.arange(around), torch.arange(across), indexing="ij")
        )
        self.u, self.v = 2 * math.pi / around * i, 2 * math.pi / across * j
        right, up = (i + 1) % around, (j + 1) % across
        a, b, c, d = i * across + j, right * across + j, right * across + up, i * across + up
        self.triangles = torch.cat([torch.stack([a, b, c], 1), torch.stack([a, c, d], 1)]).int()

    def vertices(self, theta: torch.Tensor) -> torch.Tensor:
        rho = theta[:, :1] + theta[:, 1:] * self.v.to(theta).cos()
        u, height = self.u.to(theta), theta[:, 1:] * self.v.to(theta).sin()
        return torch.stack([rho * u.cos(), rho * u.sin(), height], -1)


class Decoder(nn.Sequential):
    """From two parameters to a map, by three doublings of a small volume."""

    def __init__(self) -> None:
        side = RESOLUTION // 8
        blocks = [
            layer
            for ins, outs in ((64, 32), (32, 16), (16, 8))
            for layer in (nn.ConvTranspose3d(ins, outs, 4, stride=2, padding=1), nn.SiLU())
        ]
        super().__init__(
            nn.Linear(2, 64), nn.SiLU(), nn.Linear(64, 64 * side**3), nn.SiLU(), nn.Unflatten(1, (64, *3 * [side])),
            *blocks, nn.Conv3d(8, 1, 3, padding=1),
        )  # fmt: skip


family = Torus()
grid = family.grid(RESOLUTION)
stream = sdm.SDMStream(family, grid, batch_size=BATCH, seed=0, device="cpu")
torch.manual_seed(0)
net = Decoder()
optimizer = torch.optim.AdamW(net.parameters(), 3e-3)
schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, STEPS)
for batch in itertools.islice(stream, STEPS):
    loss = (net(2 * family.to_unit(batch.theta) - 1) - batch.sdm).abs().mean()
    optimizer.zero_grad()
    loss.backward()
    optimizer.step()
    schedule.step()

held_out = stream.validation(32)
with torch.no_grad():
    found = net(2 * family.to_unit(held_out.theta) - 1)
error = (found - held_out.sdm).abs().mean()
print(f"of shapes never seen {float(error):.3f} mm off on average; a voxel is {grid.spacing[0]:.2f} mm")

exact, predicted = (sdm.SDM(maps[0, 0], grid) for maps in (held_out.sdm, found))
side_by_side(
    exact, predicted, Path("surrogate_of_a_family.png"), title="A torus never seen: exactly, and by the network"
)
