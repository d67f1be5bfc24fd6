"""A fake board at the other end of a pseudo-terminal, of each protocol in turn."""

import pytest

from daq.protocols import session

from ..boards import FAKES


@pytest.fixture(params=list(FAKES))
def make_fake(request, tmp_path, monkeypatch):
    """Return a function that starts a fake board with faults; each protocol in turn."""
    monkeypatch.setattr(session, "QUIET_S", 0.02)
    made = []

    def make(faults=None, paced=False):
        fake = FAKES[request.param](tmp_path / "ttyFAKE", faults, paced)
        made.append(fake)
        fake.start()
        return fake

    make.kind = FAKES[request.param]
    yield make
    for fake in made:
        fake.finish()
