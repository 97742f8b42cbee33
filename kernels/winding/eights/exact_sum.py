"""The boundary's share of a winding number in float64 on a CPU: `boundary_term.boundary_part`, eight edges at once.

The eight products of complex numbers are normalised after some edges each, instead of after every one.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.bvh.tree import FRAME_SIZE, LATTICE, LOW_X, Tree, to_lattice
from sdm.kernels.winding.boundary_term import (
    LATTICE_LIMIT,
    TIE_COLUMN,
    TIE_ROW,
    TINY,
    Boundary,
    edges_of,
)

wp.set_module_options({"enable_backward": False})

# Edges of a lane after which its product is normalised: each leaves at least 0.7 of it.
STEADY = 16


@wp.func_native(
    snippet=f"""
#if !defined(__CUDA_ARCH__)
    typedef double D __attribute__((vector_size(64)));
    typedef long long L __attribute__((vector_size(64)));
    auto all = [](double x) {{ return D{{x, x, x, x, x, x, x, x}}; }};
    auto where = [](L m, D x, D y) {{ return (D)((m & (L)x) | (~m & (L)y)); }};
    auto size_of = [](D x) {{ return (D)((L)x & 0x7fffffffffffffffll); }};
    auto root = [](D x) {{ for (int k = 0; k < 8; ++k) x[k] = __builtin_sqrt(x[k]); return x; }};
    const D none = all(0.0), one = all(1.0);
    // |a| - a.x without cancellation, for `aside` the square of what is across x.
    auto side = [&](D along, D aside) {{
        const D length = root(along * along + aside);
        const L ahead = along > none;
        return where(ahead, aside / where(ahead, length + along, one), length - along);
    }};
    D re = one, im = none, turns = none;
    const L numbers = {{0, 1, 2, 3, 4, 5, 6, 7}};
    const long long qy = ray.c[0], qz = ray.c[1];
    for (int e = 0; e < count; e += 8) {{
        D ax = one, bx = one;
        L fy = L{{}}, fz = L{{}} + 1, sy = L{{}}, sz = L{{}} + 1;
        for (int k = 0; k < 8 && e + k < count; ++k) {{
            const size_t at = 2 * (size_t)(first + e + k);
            ax[k] = ends.data[at].c[0];
            bx[k] = ends.data[at + 1].c[0];
            fy[k] = lattice.data[at].c[0]; fz[k] = lattice.data[at].c[1];
            sy[k] = lattice.data[at + 1].c[0]; sz[k] = lattice.data[at + 1].c[1];
        }}
        const L there = numbers < L{{}} + (long long)(count - e);
        ax = ax - x;
        bx = bx - x;
        const D ay = step * (__builtin_convertvector(fy, D) - row + {float(TIE_ROW)!r});
        const D az = step * (__builtin_convertvector(fz, D) - column - {float(TIE_COLUMN)!r});
        const D by = step * (__builtin_convertvector(sy, D) - row + {float(TIE_ROW)!r});
        const D bz = step * (__builtin_convertvector(sz, D) - column - {float(TIE_COLUMN)!r});
        const D across = ay * bz - az * by;
        L left = across > none;
        if (on_lattice) {{
            // As `ray_crossings.is_left` has it: whole numbers of less than 2^62.
            const L cross = (sy - fy) * (qz - fz) - (sz - fz) * (qy - fy);
            const L upwards = (fy < sy) | ((fy == sy) & (fz < sz));
            left = (upwards & (cross >= L{{}})) | (~upwards & (cross > L{{}}));
        }}
        const D sides = side(ax, ay * ay + az * az) * side(bx, by * by + bz * bz);
        const D u = sides + ay * by + az * bz, v = size_of(across) + {float(TINY)!r};
        const D per = one / (size_of(u) + v);
        const D turned_x = where(there, u * per, one);
        const D turned_y = where(there, where(left, -v * per, v * per), none);
        const D new_re = re * turned_x - im * turned_y, new_im = re * turned_y + im * turned_x;
        const L below = im < none, below_now = new_im < none;
        turns = turns + where(~below & (turned_y > none) & below_now, one, none);
        turns = turns - where(below & (turned_y < none) & ~below_now, one, none);
        re = new_re;
        im = new_im;
        if (e / 8 % {STEADY} == {STEADY - 1}) {{
            const D scale = one / (size_of(re) + size_of(im) + {float(TINY)!r});
            re = re * scale;
            im = im * scale;
        }}
    }}
    double share = 0.0;
    for (int k = 0; k < 8; ++k) share += atan2(im[k], re[k]) / {2.0 * wp.PI!r} + turns[k];
    return share;
#else
    return 0.0;
#endif
"""
)
def sum_of_strips(
    ends: wp.array(dtype=wp.vec3),
    lattice: wp.array(dtype=wp.vec2i),
    first: int,
    count: int,
    ray: wp.vec2i,
    row: wp.float64,
    column: wp.float64,
    step: wp.float64,
    on_lattice: bool,
    x: wp.float64,
) -> wp.float64:
    """Strips' share of a winding number, of so many edges from the first, for the ray on the lattice from x."""
    ...


@wp.func
def exact_share(boundary: Boundary, tree: Tree, mesh: int, p: wp.vec3d):
    """The boundary's share of the winding number at p (scaled), but for the order of its sum as `boundary_winding`."""
    base = mesh * FRAME_SIZE
    steps = tree.frame[base + LATTICE]
    step = wp.float64(1.0)
    if steps > wp.float64(0.0):
        step = wp.float64(1.0) / steps
    row = wp.floor((p[1] - tree.frame[base + LOW_X + 1]) * steps)
    column = wp.floor((p[2] - tree.frame[base + LOW_X + 2]) * steps)
    on_lattice = wp.max(wp.abs(row), wp.abs(column)) < LATTICE_LIMIT
    return sum_of_strips(
        boundary.ends, boundary.lattice, mesh * boundary.count, edges_of(boundary), to_lattice(tree, mesh, p[1], p[2]),
        row, column, step, on_lattice, p[0],
    )  # fmt: skip
