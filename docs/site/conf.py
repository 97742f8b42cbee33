"""Settings of the documentation site. `make docs` builds it from pages in docs/ and beside the code."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

import sdm

project = "warp-sdm"
author = "the authors of warp-sdm"
release = version = sdm.__version__
copyright = "the authors of warp-sdm, Apache-2.0"  # noqa: A001

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
    "public_names",
    "command_help",
]
# The source folder is the checkout, so that links between pages hold on the site and in a clone alike.
root_doc = "docs/index"
include_patterns = [
    "docs/*.md",
    "docs/**/*.md",
    "sdm/*/README.md",
    "sdm/*/weights/*.md",
    "bench/README.md",
    "bench/decisions/*.md",
    "bench/results/*.md",
    "ARCHITECTURE.md",
    "CONTRIBUTING.md",
    "CHANGELOG.md",
]
# sdm/bench and sdm/kernels are links to folders that are here already.
exclude_patterns = ["sdm/bench", "sdm/kernels", "tests", ".*", "build", "dist", "demo", "runs", "**/__pycache__"]

myst_enable_extensions = ["colon_fence", "deflist"]
myst_heading_anchors = 4
# Reports of benchmarks begin at the level of the page that takes them in.
suppress_warnings = ["myst.header"]
nitpicky = False
default_role = "code"
smartquotes = False
highlight_language = "text"

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_preserve_defaults = True
autodoc_class_signature = "mixed"
python_maximum_signature_line_length = 88
# Libraries of the adapters, which the site is built without.
autodoc_mock_imports = ["batchgeneratorsv2", "jax", "monai", "nnunetv2", "pyvista", "torchio"]
napoleon_use_rtype = False
napoleon_preprocess_types = False

html_theme = "furo"
html_title = "warp-sdm"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_extra_path = ["root"]  # index.html, which leads to docs/index.html
html_show_sourcelink = False
html_copy_source = False
html_theme_options = {"navigation_with_keys": True}
copybutton_prompt_text = r"\$ |>>> |\.\.\. "
copybutton_prompt_is_regexp = True
