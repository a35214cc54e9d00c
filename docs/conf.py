"""The documentation site: `make docs` builds it into build/site."""

import importlib.metadata
import os
import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parent), str(HERE / "_ext")]
# Notebooks open no window, show their figures in the page, and import this checkout.
os.environ |= {
    "SDL_VIDEODRIVER": "dummy",
    "MPLBACKEND": "module://matplotlib_inline.backend_inline",
    "PYTHONPATH": str(HERE.parent),
    "OMP_NUM_THREADS": "1",  # two of them run at once
}

project = "Lidarnaut"
author = "The Lidarnaut developers"
release = version = importlib.metadata.version("lidarnaut")
copyright = f"2026 {author}. Lidarnaut {version}, MIT licence"

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
    "sphinx_design",
    "run_notebooks",  # which begins before pages are generated
    "generated_pages",
    "site_layout",
    "api_signatures",
]
exclude_patterns = ["_ext", "**/.ipynb_checkpoints"]
suppress_warnings = ["ref.python"]  # words of docstrings such as "height" that are attributes of several classes

myst_enable_extensions = ["colon_fence", "dollarmath"]
myst_heading_anchors = 4
nb_execution_mode = "cache"  # filled by `run_notebooks`
nb_execution_cache_path = str(HERE.parent / "build" / "notebooks")
nb_execution_timeout = 900
nb_execution_raise_on_error = True
nb_execution_show_tb = True
nb_merge_streams = True

# Docstrings write code in single backticks.
default_role = "code"
autodoc_default_options = {"members": True, "member-order": "bysource", "exclude-members": "model_config"}
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
python_maximum_signature_line_length = 100  # longer signatures get a line per argument
python_trailing_comma_in_multi_line_signatures = False
autodoc_preserve_defaults = True
autosummary_generate = False
napoleon_use_rtype = False
napoleon_use_ivar = True

html_theme = "furo"
html_title = "Lidarnaut"
html_copy_source = False
html_logo = html_favicon = "_static/logo.svg"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_theme_options = {"navigation_with_keys": True}
copybutton_prompt_text = r">>> |\$ "
copybutton_prompt_is_regexp = True
