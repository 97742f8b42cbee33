"""Eight boxes or triangles of the tree at once, on a CPU, which has registers for eight numbers."""

from __future__ import annotations

import warp as wp

from sdm.kernels.bvh.tree import Tree, first_triangle, slots_of

wp.set_module_options({"enable_backward": False})

Eight = wp.types.vector(length=8, dtype=wp.float32)


@wp.func
def eights_depth(tree: Tree):
    """Levels to look at: one less than there are where two leaves have no more than eight triangles together."""
    depth = tree.depth
    if depth > 0 and tree.count <= 8 << (depth - 1):
        depth = depth - 1
    return depth


@wp.func
def eights_step(node: int, depth: int):
    """Levels from a node down to what is looked at together: three, of the root what is more than a multiple of it."""
    step = int(3)
    if node == 1 and depth % 3 != 0:
        step = depth % 3
    return step


@wp.func
def eights_leaf(tree: Tree, mesh: int, leaf: int, pairs: int):
    """First slot and number of the triangles of a leaf, or, if `pairs` is 1, of it and the next."""
    begin = first_triangle(tree, leaf)
    return slots_of(tree, mesh) + begin, first_triangle(tree, leaf + 1 + pairs) - begin


# `box_distance2` of nodes that follow each other.
@wp.func_native(
    snippet="""
    wp::vec_t<8, float> found;
#if !defined(__CUDA_ARCH__)
    typedef float four __attribute__((vector_size(16), aligned(4)));
    auto largest = [](four x, four y) { return x > y ? x : y; };
    const four at = {p.c[0], p.c[1], p.c[2], 0.0f}, none = {0.0f, 0.0f, 0.0f, 0.0f};
    const float* box = boxes.data + 8 * (size_t)first;
    for (int k = 0; k < 8; k += 4) {
        if (k >= count) {
            for (int j = k; j < 8; ++j) found.c[j] = INFINITY;
            break;
        }
        four square[4];
        for (int j = 0; j < 4; ++j) {
            // Of fewer than four the last one again.
            const float* one = box + 8 * (k + j < count ? k + j : count - 1);
            const four away = largest(largest(*(const four*)one - at, at - *(const four*)(one + 4)), none);
            square[j] = away * away;
        }
        const four xy01 = __builtin_shufflevector(square[0], square[1], 0, 4, 1, 5);
        const four xy23 = __builtin_shufflevector(square[2], square[3], 0, 4, 1, 5);
        const four z01 = __builtin_shufflevector(square[0], square[1], 2, 6, 2, 6);
        const four z23 = __builtin_shufflevector(square[2], square[3], 2, 6, 2, 6);
        const four sum = __builtin_shufflevector(xy01, xy23, 0, 1, 4, 5)
            + __builtin_shufflevector(xy01, xy23, 2, 3, 6, 7) + __builtin_shufflevector(z01, z23, 0, 1, 4, 5);
        for (int j = 0; j < 4; ++j) found.c[k + j] = k + j < count ? sum[j] : INFINITY;
    }
#endif
    return found;
"""
)
def eight_boxes(boxes: wp.array(dtype=wp.float32), first: int, count: int, p: wp.vec3) -> Eight:
    """On a CPU, squared distances of p from the boxes of `count` <= 8 nodes from `first` on; else infinite."""
    ...


# `nearest_part` of triangles that follow each other; their data lie one after the other, and are turned first.
@wp.func_native(
    snippet="""
    wp::vec_t<8, float> found;
#if !defined(__CUDA_ARCH__)
    {
    // Products and sums as one operation: within the room that a search has for rounding.
    #pragma clang fp contract(fast)
    typedef float four __attribute__((vector_size(16), aligned(4)));
    typedef float eight __attribute__((vector_size(32)));
    typedef int mask __attribute__((vector_size(32)));
    auto all = [](float x) { return eight{x, x, x, x, x, x, x, x}; };
    const float* data = (const float*)(corners.data + 4 * (size_t)first);
    eight columns[12];
    for (int row = 0; row < 3; ++row) {
        eight pairs[4];
        for (int k = 0; k < 4; ++k) {
            // Of fewer than eight the last one again.
            const four low = *(const four*)(data + 12 * (k < count ? k : count - 1) + 4 * row);
            const four high = *(const four*)(data + 12 * (k + 4 < count ? k + 4 : count - 1) + 4 * row);
            pairs[k] = __builtin_shufflevector(low, high, 0, 1, 2, 3, 4, 5, 6, 7);
        }
        const eight a = __builtin_shufflevector(pairs[0], pairs[1], 0, 8, 1, 9, 4, 12, 5, 13);
        const eight b = __builtin_shufflevector(pairs[0], pairs[1], 2, 10, 3, 11, 6, 14, 7, 15);
        const eight c = __builtin_shufflevector(pairs[2], pairs[3], 0, 8, 1, 9, 4, 12, 5, 13);
        const eight d = __builtin_shufflevector(pairs[2], pairs[3], 2, 10, 3, 11, 6, 14, 7, 15);
        columns[4 * row] = __builtin_shufflevector(a, c, 0, 1, 8, 9, 4, 5, 12, 13);
        columns[4 * row + 1] = __builtin_shufflevector(a, c, 2, 3, 10, 11, 6, 7, 14, 15);
        columns[4 * row + 2] = __builtin_shufflevector(b, d, 0, 1, 8, 9, 4, 5, 12, 13);
        columns[4 * row + 3] = __builtin_shufflevector(b, d, 2, 3, 10, 11, 6, 7, 14, 15);
    }
    struct three { eight x, y, z; };
    auto less = [](three u, three v) { return three{u.x - v.x, u.y - v.y, u.z - v.z}; };
    auto dot = [](three u, three v) { return u.x * v.x + u.y * v.y + u.z * v.z; };
    auto cross = [](three u, three v) {
        return three{u.y * v.z - u.z * v.y, u.z * v.x - u.x * v.z, u.x * v.y - u.y * v.x};
    };
    const three a = {columns[0], columns[1], columns[2]}, b = {columns[3], columns[4], columns[5]};
    const three c = {columns[6], columns[7], columns[8]}, n = {columns[9], columns[10], columns[11]};
    const three at = {all(p.c[0]), all(p.c[1]), all(p.c[2])};
    const three pa = less(at, a), pb = less(at, b), pc = less(at, c);
    const three ab = less(b, a), bc = less(c, b), ca = less(a, c);
    const eight zero = all(0.0f), one = all(1.0f);
    // As `nearest_of_segment`; of a segment without a length the quotient is none, and its beginning is nearest.
    auto parameter = [&](three q, three e) {
        const eight length2 = dot(e, e), t = dot(q, e) / length2;
        const eight up = t > zero ? t : zero;
        return up < one ? up : one;
    };
    auto square = [&](three q, three e, eight t) {
        const three r = {q.x - t * e.x, q.y - t * e.y, q.z - t * e.z};
        return dot(r, r);
    };
    const eight t_ab = parameter(pa, ab), t_bc = parameter(pb, bc), t_ca = parameter(pc, ca);
    eight d2 = square(pa, ab, t_ab);
    const eight d2_bc = square(pb, bc, t_bc), d2_ca = square(pc, ca, t_ca);
    d2 = d2_bc < d2 ? d2_bc : d2;
    d2 = d2_ca < d2 ? d2_ca : d2;
    const mask inside = (dot(cross(n, ab), pa) >= zero) & (dot(cross(n, bc), pb) >= zero)
        & (dot(cross(n, ca), pc) >= zero) & (dot(n, n) > all(0.5f));
    const mask beyond = ((t_ca == one) & (t_ab == zero)) | ((t_ab == one) & (t_bc == zero))
        | ((t_bc == one) & (t_ca == zero));
    const eight h = dot(n, pa);
    d2 = (inside & ~beyond) ? h * h : d2;
    for (int k = 0; k < 8; ++k) found.c[k] = k < count ? d2[k] : INFINITY;
    }
#endif
    return found;
"""
)
def eight_triangles(corners: wp.array(dtype=wp.vec3), first: int, count: int, p: wp.vec3) -> Eight:
    """On a CPU, squared distances of p from `count` <= 8 triangles from slot `first` on; else infinite."""
    ...
