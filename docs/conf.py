"""Settings of the documentation site: ``make docs`` builds it into build/site.

Everything that a page shows is in the site itself, so that it opens from disk without a network.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "site"))

project = "wovenfab"
author = "wovenfab contributors"
copyright = "wovenfab contributors, MIT licence"

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "generated_parts",
    "project_files",
]
exclude_patterns = ["site", "examples"]

myst_heading_anchors = 4  # links to headings are those of GitHub
myst_enable_extensions = ["html_image"]
smartquotes = False  # two hyphens begin an option
suppress_warnings = ["myst.header"]  # pages that programs write may skip a level

autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
napoleon_use_rtype = False

html_theme = "furo"
html_title = "wovenfab"
html_static_path = ["site/style.css"]
html_css_files = ["style.css"]
html_copy_source = False
html_show_sourcelink = False
