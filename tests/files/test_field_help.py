import dataclasses
import pydoc

import pytest

from lidarnaut.envs.robots import LidarParams, RobotParams, robot_params
from lidarnaut.envs.simulation import Crowd

RECORDS = [kind for kind in vars(robot_params).values() if dataclasses.is_dataclass(kind)]


@pytest.mark.parametrize("kind", [*RECORDS, Crowd])
def test_help_lists_all_fields_with_their_docstrings_and_no_internals(kind):
    text = pydoc.plain(pydoc.render_doc(kind))
    for field in dataclasses.fields(kind):
        assert f" |  {field.name}\n |      " in text, field.name
    assert "pydantic" not in text
    assert "FieldInfo" not in text
    assert "__" not in text


def test_help_on_a_robot_has_units_and_types():
    text = pydoc.plain(pydoc.render_doc(RobotParams))
    assert " |  max_v\n |      Maximum forward and backward speed [m/s].\n" in text
    assert "max_v: float" in text
    assert " |  range_max\n |      Maximum range [m].\n" in pydoc.plain(pydoc.render_doc(LidarParams))
