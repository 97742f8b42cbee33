"""One closed surface from a soup: triangles that share no corner, a third of them turned round, one in twenty lost."""

import torch

import sdm
from sdm.viz.figure import picture

whole = sdm.shapes.Cochlea(5_000).mesh([3.6, 0.3, 0.139, -0.17])
torch.manual_seed(0)
corners = whole.vertices[whole.faces.long()]  # (F,3,3)
corners = corners[torch.rand(len(corners)) > 0.05]
turned = torch.rand(len(corners)) < 1 / 3
corners[turned] = corners[turned].flip(1)
soup = sdm.TriangleMesh(corners.reshape(-1, 3), torch.arange(3 * len(corners)).reshape(-1, 3))

before, after = sdm.inspect_mesh(soup), sdm.watertight(soup, resolution=96)
print(f"before: closed {before.closed}, {before.components:,} components, sign {before.recommended_sign}")
report = sdm.inspect_mesh(after)
print(f"after: closed {report.closed}, {report.components} components, faces outward: {report.outward}")
far = sdm.signed_distance(whole, after.vertices).abs().max()
change = report.volume / sdm.inspect_mesh(whole).volume - 1
print(f"the surface is at most {float(far):.3f} from the mesh as it was; its volume changed by {change:+.0%}")

picture(sdm.signed_distance_map(after, 64), "watertight_from_soup.png", title="A closed surface from a soup")
