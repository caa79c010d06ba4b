"""Fault forms: built from the emulator's descriptions, and converted to arguments it accepts."""

import pytest

from client.pendant.screens.simulation_faults import SUBJECTS, FaultField, FaultKind, fault_arguments, fault_kinds
from emulator.faults.catalogue import kinds, make_fault
from tests.rows import each_row

PORTS = ["dashboard", "rtde", "control"]
KINDS = {kind["kind"]: kind for kind in kinds()}


@pytest.fixture
def forms() -> dict[str, FaultKind]:
    return fault_kinds(list(KINDS.values()), PORTS)


def initial_value(field: FaultField) -> object:
    """The initial content of a field, or an example for a required one."""
    if field.required:
        return next(iter(field.choices)) if field.choices else {"text": "word", "int": "3", "float": "0.25"}[field.type]
    if field.type == "bool" or field.choices:
        return field.default
    return "" if field.default is None else str(field.default)


@each_row("name", KINDS)
def test_form_of_every_kind_creates_its_fault(forms, name) -> None:
    form = forms[name]
    arguments = fault_arguments(form, {field.name: initial_value(field) for field in form.fields})
    assert set(arguments) == {field.name for field in form.fields if field.required}
    assert make_fault(name, arguments).kind == name


@each_row("name", KINDS)
def test_defaults_are_valid_choices(forms, name) -> None:
    for field in forms[name].fields:
        assert not field.choices or field.required or field.default in field.choices


def test_changed_fields_are_converted(forms) -> None:
    shown = {"port": "rtde", "direction": "both", "delay_s": "0.05", "lasting": "2", "seed": "7", "once": True}
    arguments = fault_arguments(forms["delay"], shown)
    assert arguments == {**shown, "delay_s": 0.05, "lasting": 2.0, "seed": 7}
    assert isinstance(arguments["seed"], int)


def test_port_choices_include_all_ports_but_control_api(forms) -> None:
    port = next(field for field in forms["stall"].fields if field.name == "port")
    assert list(port.choices) == ["", "dashboard", "rtde", "scripts"]


@each_row(
    ("kind", "shown", "message"),
    [
        ("encoder_jump", {}, "needs joint, by_rad"),
        ("encoder_jump", {"joint": 1, "by_rad": "much"}, "by_rad must be a number, not 'much'"),
        ("delay", {"delay_s": "0.1", "seed": "1.5"}, "seed must be a whole number"),
    ],
)
def test_missing_or_invalid_fields_are_reported(forms, kind, shown, message) -> None:
    with pytest.raises(ValueError, match=message):
        fault_arguments(forms[kind], shown)


def test_every_fault_subject_has_a_title():
    assert {kind["subject"] for kind in kinds()} == SUBJECTS.keys()
