"""Points that slide down the distance onto a surface: derivatives by points, and by vertices of the mesh."""

import matplotlib.pyplot as plt
import torch

import sdm
from sdm.viz import STYLE

family = sdm.shapes.make_family("cuboid")
mesh = family.mesh([(p.low + p.high) / 2 for p in family.parameters])
low, high = (torch.tensor(corner) for corner in sdm.inspect_mesh(mesh).bounds)

torch.manual_seed(0)
points = (low + (high - low) * (2 * torch.rand(400, 3) - 0.5)).requires_grad_()
path = [points.detach().clone()]
optimizer = torch.optim.SGD([points], lr=0.25)
for _ in range(12):
    distance = sdm.signed_distance(mesh, points)
    (distance**2).sum().backward()  # the derivative of a distance is a unit vector that points outward
    optimizer.step()
    optimizer.zero_grad()
    path.append(points.detach().clone())
left = sdm.signed_distance(mesh, points).detach().abs()
print(f"furthest point after 12 steps: {float(left.max()):.2e} of a box {float((high - low).max()):.2f} wide")

# The same by the mesh: how must vertices move so that the points come nearer?
vertices = mesh.vertices.clone().requires_grad_()
loss = sdm.signed_distance(sdm.TriangleMesh(vertices, mesh.faces), path[0]).square().mean()
loss.backward()
print(f"derivative by {len(vertices)} vertices, largest {float(vertices.grad.norm(dim=1).max()):.2e}")

plt.rcParams.update(STYLE)
figure, axes = plt.subplots(figsize=(4.5, 4.5), layout="constrained")
for track in torch.stack(path, 1)[:, :, :2]:
    axes.plot(*track.T.numpy(), lw=0.6, color="0.7")
axes.scatter(*points.detach()[:, :2].T.numpy(), s=4)
axes.set(aspect="equal", xlabel="x", ylabel="y", title="400 points descend onto a box")
figure.savefig("descend_onto_a_surface.png", dpi=100)
