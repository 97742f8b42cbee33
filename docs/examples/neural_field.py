"""A neural field of one mesh: exact samples near its surface, a small network, and the surface that it has learnt."""

import torch
from torch import nn

import sdm
from sdm.sampling import sample
from sdm.viz.figure import picture

STEPS, BATCH = 400, 1_024

mesh = sdm.shapes.make_family("cuboid").mesh([0.7, 0.5, 0.35, 0.1, 0.3, 0.6])
samples = sample(
    mesh, 50_000, seed=0
)  # DeepSDF's law: 95 % near the surface, the rest in the box; the unit ball's size
points, distances = samples.points.cpu(), samples.distances.cpu()

torch.manual_seed(0)
frequencies = 2.0 * torch.randn(3, 32)  # random Fourier features (Tancik et al. 2020)
net = nn.Sequential(nn.Linear(64, 128), nn.SiLU(), nn.Linear(128, 128), nn.SiLU(), nn.Linear(128, 1))


def field(at: torch.Tensor) -> torch.Tensor:
    angles = at @ frequencies
    return net(torch.cat([angles.sin(), angles.cos()], -1)).squeeze(-1)


optimizer = torch.optim.Adam(net.parameters(), 2e-3)
schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, STEPS)
for _ in range(STEPS):
    chosen = torch.randint(len(points), (BATCH,))
    loss = (field(points[chosen]) - distances[chosen]).abs().mean()
    optimizer.zero_grad()
    loss.backward()
    optimizer.step()
    schedule.step()

grid = sdm.Grid((-1, -1, -1), (2 / 47,) * 3, (48, 48, 48))
axis = torch.linspace(-1, 1, 48)
with torch.no_grad():
    values = field(torch.stack(torch.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)).reshape(48, 48, 48)
learnt = sdm.SDM(values, grid)
surface = learnt.to_mesh()
exact = sdm.signed_distance(samples.normalization.normalised(mesh), surface.vertices).abs()
print(f"the learnt surface is {float(exact.mean()):.4f} from the true one on average, of a shape 2 wide")
picture(learnt, "neural_field.png", title=f"A neural field after {STEPS} steps")
