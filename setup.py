"""Make the description of the package: README.md without pictures and links that lead into the checkout."""

import re
from pathlib import Path

from setuptools import setup

HERE = Path(__file__).parent
if not (HERE / "lidarnaut" / "envs").is_dir():
    raise SystemExit("lidarnaut/envs is no link: clone again after `git config --global core.symlinks true`")
text, *_ = (HERE / "README.md").read_text(encoding="utf-8").partition("## Read on")
text = re.sub(r"!\[[^]]*\]\((?!https:)[^)]*\)\n+", "", text)
text = re.sub(r"\[([^]]+)\]\((?!https:|#)[^)]*\)", r"\1", text)
setup(long_description=text, long_description_content_type="text/markdown")
