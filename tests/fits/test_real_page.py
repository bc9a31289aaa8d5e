"""The page of scores on real recordings: one section a fit, the others left as they are."""

from fits.common import Row, keep


def test_a_section_is_written_anew_and_others_stay(tmp_path):
    page = tmp_path / "real.md"
    keep(page, "tanks", ["| old |"])
    keep(page, "cavatappi", [Row("cavatappi", "500 g", "NRMSE, %", 50.0, 91.23, "creep", 12.0).text()])
    before = page.read_text(encoding="utf-8")
    keep(page, "tanks", ["| new |", "", "est: the upper tank overflows 1 to 2 s"])
    after = page.read_text(encoding="utf-8")
    assert "| old |" in before
    assert "| old |" not in after
    assert "est: the upper tank overflows 1 to 2 s" in after
    first, last = after.index("## cavatappi"), after.index("## tanks")
    assert after[:last].rstrip() == before[: before.index("## tanks")].rstrip()
    assert first < last
    assert after.startswith("# Real recordings")
    assert "python -m fits.tanks.run --page" in after
    assert "| 50 | 91.23 | creep | 12 |" in after
