import pytest


@pytest.fixture
def no_overview(monkeypatch):
    """Skip the slow pictures over all worlds."""
    for name in ("curves_section", "gallery_section", "worst_section"):
        monkeypatch.setattr(f"lidarnaut.benchmarks.arena.overview.{name}", lambda *_: None)
