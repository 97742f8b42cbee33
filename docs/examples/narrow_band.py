"""Only the voxels near the surface: a map in a small share of the memory, made, sampled and saved."""

import matplotlib.pyplot as plt
import torch

import sdm
from sdm.viz import STYLE

mesh = sdm.shapes.Cochlea(5_000).mesh([3.6, 0.3, 0.139, -0.17])
counts = []
for resolution in (64, 128, 256, 512):
    grid = sdm.Grid.around(mesh, resolution=resolution)
    band = sdm.narrow_band(mesh, grid, half_width=3.0)
    counts.append((resolution, 4 * grid.size / 2**20, band.nbytes / 2**20))
    print(f"{resolution}^3: {counts[-1][2]:.1f} MiB instead of {counts[-1][1]:,.1f}")

band.save("narrow_band.npz")
band = sdm.load("narrow_band.npz")
points = mesh.vertices[:5] + 0.1 * torch.randn(5, 3)
print("interpolated", band.sample(points), "exact", sdm.signed_distance(mesh, points).clamp(-band.width, band.width))

sides, dense, sparse = zip(*counts, strict=True)
plt.rcParams.update(STYLE)
figure, axes = plt.subplots(figsize=(5, 3.5), layout="constrained")
axes.loglog(sides, dense, "o-", color="0.6", label="dense map", base=2)
axes.loglog(sides, sparse, "o-", label="band of 3 voxels", base=2)
axes.set(xlabel="voxels a side", ylabel="memory [MiB]", title="A band grows with the surface")
axes.legend()
figure.savefig("narrow_band.png", dpi=100)
