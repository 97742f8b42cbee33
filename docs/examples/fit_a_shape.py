"""The shape and the pose of a cochlea in a CT-like image, and how sure of them one may be."""

from pathlib import Path

from sdm.fit import ExactBackend, FitOptions, Scanner, fit_shape, random_state, simulate
from sdm.shapes import Cochlea
from sdm.viz.fit_figure import draw_fit

backend = ExactBackend(Cochlea(1_000), device="cpu")
truth = random_state(backend, seed=5, edge=0.25)
image = simulate(backend, truth, Scanner(spacing=0.5, blur=0.25, noise=200.0), seed=1)

result = fit_shape(image.values, image.grid, backend, options=FitOptions(blur=0.25, fine=0.25))
result.require()  # raises FitError where there is no answer
intervals = result.posterior.intervals(0.9)
for i, parameter in enumerate(backend.family.parameters):
    true, found, (low, high) = float(truth.theta[i]), float(result.state.theta[i]), intervals[i]
    print(f"{parameter.name:>6}: true {true:6.3f}, found {found:6.3f}, 90 % interval {low:6.3f} to {high:6.3f}")
draw_fit(image.values, image.grid, backend, result, Path("fit_a_shape.png"))
