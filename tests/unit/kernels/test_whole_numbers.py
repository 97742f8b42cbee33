"""Whole numbers in kernels are int32 until they are converted: larger ones would make Clang warn as it compiles."""

from __future__ import annotations

import ast


def test_no_number_in_a_kernel_is_beyond_int32(root):
    found = []
    for path in sorted((root / "kernels").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.FunctionDef) and any(_is_warps(d) for d in node.decorator_list):
                found += [
                    f"{path.relative_to(root)}:{n.lineno}: {n.value}"
                    for n in ast.walk(node)
                    if isinstance(n, ast.Constant) and type(n.value) is int and not -(2**31) <= n.value < 2**31
                ]
    assert not found, "write them as constants of the module, such as wp.uint32(0xD2511F53)"


def _is_warps(decorator: ast.expr) -> bool:
    return ast.unparse(decorator).startswith(("wp.func", "wp.kernel"))
