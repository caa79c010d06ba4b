"""Availability of features in the three software lines."""

from tests.rows import each_row
from urproto.versions import Availability, PolyscopeVersion, Series


@each_row(
    ("e", "x"),
    [
        ("5.21", "10.8"),  # optimovej: the C++ client's control program
        ("5.22", "10.9"),  # UR7e: its start script
        ("5.23", "10.11"),  # energies of RTDE: its tests; UR8 Long: its start script
        ("5.25.1", "10.12"),  # friction scales: its tests have 10.12.1
        ("5.0", "10.0"),
        ("5.26", "10.13"),
    ],
)
def test_features_of_a_5_x_are_in_the_corresponding_10_x(e: str, x: str) -> None:
    first = PolyscopeVersion.parse(x)
    assert Availability.since(None, e).x == first
    assert Availability.since(None, e).covers(first)
    assert x == "10.0" or not Availability.since(None, e).covers(PolyscopeVersion(10, first.minor - 1, 9))


def test_an_explicit_pair_of_versions_is_used() -> None:
    scales = Availability.since(None, "5.25.1", "10.12.1")
    covered = {text for text in ("5.25", "5.25.1", "10.12", "10.12.1", "10.7", "3.15") if
               scales.covers(PolyscopeVersion.parse(text))}  # fmt: skip
    assert covered == {"5.25.1", "10.12.1"}


def test_a_software_line_may_lack_a_feature() -> None:
    lines = ("3.15", "5.25", "10.13")
    for availability, having in (
        (Availability.since("3.0", "5.0", None), {"3.15", "5.25"}),
        (Availability.since(None, None, "10.11"), {"10.13"}),
        (Availability.since("3.0", None), {"3.15"}),
    ):
        assert {text for text in lines if availability.covers(PolyscopeVersion.parse(text))} == having


@each_row(
    ("availability", "text"),
    [
        (Availability.since("3.12", "5.6"), "CB3 since 3.12, e-Series since 5.6"),
        (Availability.since(None, "5.13"), "e-Series since 5.13 only"),
        (Availability.since(None, "5.23", "10.11"), "e-Series since 5.23, PolyScope X since 10.11"),
        (Availability.since(None, None, "10.12"), "PolyScope X since 10.12 only"),
        (Availability.since(None, None), "no series"),
    ],
)
def test_availability_as_text(availability: Availability, text: str) -> None:
    assert str(availability) == text


def test_polyscope_x_runs_on_e_series_arms() -> None:
    version = PolyscopeVersion.parse("10.12.1")
    assert (version.is_polyscope_x, version.series) == (True, Series.E)
