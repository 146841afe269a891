"""All tests of phases and codes once more, for the plain decoder that the compiled one copies."""

from __future__ import annotations

from functools import partial

import pytest
import test_decode_code
import test_decode_phase

from fringe3d.decode import decode, wrapped_phase

globals().update(
    (name, test)
    for module in (test_decode_phase, test_decode_code)
    for name, test in vars(module).items()
    if name.startswith("test_")
)


@pytest.fixture(autouse=True)
def plain(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the tests call the plain decoder."""
    monkeypatch.setattr(test_decode_phase, "wrapped_phase", partial(wrapped_phase, plain=True))
    monkeypatch.setattr(test_decode_code, "decode", partial(decode, plain=True))


def test_the_plain_decoder_is_what_is_tested(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the compiled one they must work as well."""
    monkeypatch.setattr("fringe3d.decode.fused._fused.decode_pixels", None)
    assert vars(test_decode_phase)["wrapped_phase"].keywords == {"plain": True}
    assert vars(test_decode_code)["decode"].keywords == {"plain": True}
    test_decode_phase.test_tiny_images_decode_to_the_true_phase((2, 2), 4)
    test_decode_code.test_saturated_and_dark_pixels_have_no_order()
