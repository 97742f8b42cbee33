"""Signed distances and maps for JAX, inside `jit` and with gradients.

    from sdm.jax import signed_distance
    loss = jax.jit(lambda points: jnp.abs(signed_distance(vertices, faces, points)).sum())
    jax.grad(loss)(points)

The engine is the same, so values and gradients have torch's bits: JAX hands its arrays over where they are, on a CPU or
an NVIDIA GPU, through Warp's `jax_callable`. Reverse mode works (`grad`, `vjp`), once; forward mode does not. `vmap`
goes through its batch one by one. JAX takes three quarters of a GPU's memory when it starts unless the environment
variable XLA_PYTHON_CLIENT_PREALLOCATE is false; torch needs its share.
"""

from sdm.jax.distances import Sign, signed_distance, signed_distance_map

__all__ = ["Sign", "signed_distance", "signed_distance_map"]
