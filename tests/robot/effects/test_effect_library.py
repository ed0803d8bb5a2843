"""Properties of every effect and law: names, shapes, units, the same columns and values on any data."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cellapp.robot.effects import EFFECTS, ActsOn, Law, MeasurementConditions
from cellapp.robot.effects.data_driven import acted_on, variables
from tests.approved import assert_refused
from tests.robot.effects.cell import NOTHING, by_name, chain, context_of, curve_laws, pair_laws, rows_of, under

CONTEXT = context_of()
CONDITIONS: Any = CONTEXT.conditions


def ends(laws):
    """First and last law of each form: those between differ only in a constant."""
    by_law: dict[str, list[Law]] = {}
    for law in laws:
        by_law.setdefault(law.name, []).append(law)
    return [law for same_name in by_law.values() for law in same_name[:: max(len(same_name) - 1, 1)]]


NAMED = [(slug, law) for slug, effect in EFFECTS.items() for law in ends(effect.laws(CONTEXT))]
PERIODIC = EFFECTS["transmission_error"]
CURVE = PERIODIC.law("curve", {"cycles": 12.0, "length2": 0.3, "amplitude2": 1e-4, "length3": 0.5, "amplitude3": 2e-4})
GEAR = PERIODIC.law("gear", {"ratio": 50.0}, 209)
NAMED += [("transmission_error", CURVE), ("transmission_error", GEAR)]
WHOLE = [law for law in curve_laws(CONTEXT) if "period_s" not in law.constants]
OSCILLATIONS = [law for law in curve_laws(CONTEXT) if "period_s" in law.constants]
ACTED_ON = {acts_on.name: acts_on for acts_on in acted_on(6)}
VARIABLES = {variable.name: variable for variable in variables(CONTEXT)}


def data_driven_laws():
    """Every channel with one variable, every variable with one channel, a few periods, pairs of every kind."""
    ways, names = list(ACTED_ON), list(VARIABLES)
    meeting = {f"{ways[k % len(ways)]}|{names[k % len(names)]}" for k in range(max(len(ways), len(names)))}
    sampled = [law for law in WHOLE if law.name in meeting]
    sampled += OSCILLATIONS[::173]
    several = [VARIABLES[name] for name in ("q2", "other q3", "time", "torque2", "payload", "azimuth")]
    sampled += pair_laws(CONTEXT, ACTED_ON["tool y"], several)[::2]
    sampled += pair_laws(CONTEXT, ACTED_ON["base shift"], [VARIABLES[name] for name in ("q1", "q5", "elevation")])
    return [("unknown", law) for law in sampled]


ALL = NAMED + data_driven_laws()


def values_of(column):
    return column.offset if column.joint is not None else column.shift_M


def same(one, other):
    """Whether two columns are equal except for their values."""
    ones, others = vars(one), vars(other)
    return all(ones[key] == others[key] for key in ones if key not in ("offset", "shift_M"))


def close(columns, others, rows=slice(None), other_rows=slice(None), atol=1e-14):
    """Compare all values at once: one comparison per column is slow with thousands of columns."""
    for is_joint in (True, False):
        ours = [values_of(c)[rows] for c in columns if (c.joint is not None) == is_joint]
        theirs = [values_of(c)[other_rows] for c in others if (c.joint is not None) == is_joint]
        np.testing.assert_allclose(np.array(ours), np.array(theirs), rtol=1e-12, atol=atol)


def test_the_vocabulary_is_complete_and_in_order():
    vocabulary = (
        "joint_compliance payload_compliance encoder_eccentricity transmission_error backlash "
        "friction_windup unsettled_measurement joint_axis_wobble joint_axis_runout thermal_growth "
        "joint_drift base_drift base_step target_slip pedestal_compliance pedestal_coupling link_bending "
        "tracker_scale tracker_distance_offset tracker_angle_error target_incidence unknown"
    )
    assert list(EFFECTS) == vocabulary.split()
    for slug, effect in EFFECTS.items():
        assert effect.slug == slug
        assert effect.title
        assert set(effect.confounded) <= set(EFFECTS) - {slug}
        assert slug == "unknown" or effect.variables


def columns_are_well_formed(slug, law):
    columns = EFFECTS[slug].columns(CONTEXT, law)
    assert columns
    by_name(columns)
    for column in columns:
        assert column.block
        assert column.where.split()[0] in ("joint", "link", "all", "base", "tool", "tracker")
        assert (column.index is None) == (column.where in ("all links", "all joints", "base", "tool", "tracker"))
        assert (column.acts_on is ActsOn.JOINT) == (column.joint is not None) == (column.offset is not None)
        assert (column.acts_on is ActsOn.JOINT) == (column.shift_M is None)
        assert column.lower < column.upper
        assert column.lower <= 0.0 <= column.upper
        values = values_of(column)
        assert np.isfinite(values).all()
        if column.joint is None:
            assert column.offset is None
            assert values.shape == (len(CONTEXT), 3)
            of_loads = ("rad/Nm", "m/Nm", "1/(N m^2)", "1/N", "rad/N", "m/N")
            assert column.unit in ("m", "rad", "m/m", "1/K", "m/K", *of_loads)
        else:
            assert column.shift_M is None
            assert values.shape == (len(CONTEXT),)
            assert column.where == f"joint {column.joint + 1}"
            assert column.unit in ("rad", "rad/Nm", "rad/N", "rad/rad", "rad/K")


def a_subset_of_the_stops_has_the_same_values(slug, law):
    """A law carries all constants that it took from its run: a subset of the stops gives the same values."""
    columns = EFFECTS[slug].columns(CONTEXT, law)
    rows = np.array([3, 17, 5])
    parts = EFFECTS[slug].columns(rows_of(CONTEXT, rows), law)
    assert all(same(column, part) for column, part in zip(columns, parts, strict=True))
    close(parts, columns, other_rows=rows)


def the_same_columns_where_nothing_is_known(slug, law):
    columns = EFFECTS[slug].columns(CONTEXT, law)
    for other in (under(CONTEXT, NOTHING), replace(under(CONTEXT, NOTHING), smr_normal=None)):
        unknown = EFFECTS[slug].columns(other, law)
        for column, part in zip(columns, unknown, strict=True):
            assert same(column, part)
            assert np.isfinite(values_of(part)).all()


def unknown_in_a_row_is_unknown_in_that_row_only(slug, law):
    conditions = CONDITIONS
    holed: dict[str, Any] = {}
    for name, values in vars(conditions).items():
        if name != "record" and values is not None:  # the record is of the whole run, not per stop
            holed[name] = np.array(values, dtype=np.float64)
            holed[name][4] = 0.0 if name == "approach" else np.nan
    some = EFFECTS[slug].columns(under(CONTEXT, replace(conditions, **holed)), law)
    full = EFFECTS[slug].columns(CONTEXT, law)
    none = EFFECTS[slug].columns(under(CONTEXT, NOTHING), law)
    rest = np.arange(len(CONTEXT)) != 4
    assert len(some) == len(full) == len(none)
    close(some, none, rows=4, other_rows=4)
    close(some, full, rows=rest, other_rows=rest)


def a_law_survives_json(slug, law):
    assert all(type(value) is float for value in law.constants.values())
    again = EFFECTS[slug].law(law.name, json.loads(json.dumps(dict(law.constants))), law.tried)
    assert again == law
    assert law.tried >= 1


CLAIMS = (
    columns_are_well_formed,
    a_subset_of_the_stops_has_the_same_values,
    the_same_columns_where_nothing_is_known,
    unknown_in_a_row_is_unknown_in_that_row_only,
    a_law_survives_json,
)


@pytest.mark.parametrize("claim", CLAIMS, ids=lambda one: one.__name__)
@pytest.mark.parametrize("slug", EFFECTS)
def test_of_every_law(slug, claim):
    for law in (law for its, law in ALL if its == slug):
        claim(slug, law)


def test_the_independent_chain_agrees_with_the_arm():
    for row in range(3):
        walked = chain(CONTEXT, row)
        np.testing.assert_allclose(walked.smr, CONTEXT.p_M[row], atol=1e-12)
        for i, pose in enumerate(walked.frames):
            np.testing.assert_allclose(pose[:3, :3], CONTEXT.frames[0][i, row], atol=1e-12)


# -- missing data ----------------------------------------------------------------------------------------------------


def test_missing_data_are_reported_as_approved():
    """Lines name an effect and the only condition that is known, in words of numpy."""

    def missing(slug: str, known: str = "") -> str:
        name, _, values = known.partition("=")
        conditions = {name: eval(values, vars(np).copy())} if known else {}
        assert EFFECTS[slug].missing_data(CONTEXT) == ""
        return EFFECTS[slug].missing_data(under(CONTEXT, MeasurementConditions(**conditions)))

    assert_refused(Path(__file__).parent / "approved" / "missing-data.txt", missing)
