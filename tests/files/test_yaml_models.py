from dataclasses import dataclass

import pytest
from pydantic import BaseModel, ConfigDict, PositiveFloat

from lidarnaut.envs.files import dump_record, parse_record, read_mapping, read_record


@dataclass(frozen=True)
class Wheel:
    __pydantic_config__ = ConfigDict(extra="forbid")

    radius: float

    def __post_init__(self) -> None:
        if self.radius <= 0:
            raise ValueError(f"radius must be positive, got {self.radius}")


class Cart(BaseModel):
    model_config = ConfigDict(extra="forbid")

    speed: PositiveFloat
    wheels: list[Wheel] = []
    spare: Wheel | None = None


def test_a_record_survives_being_written(tmp_path):
    cart = Cart(speed=3e-4, wheels=[Wheel(radius=0.1)])
    (tmp_path / "cart.yaml").write_text(dump_record(cart))
    assert read_record(tmp_path / "cart.yaml", Cart) == cart
    (tmp_path / "cart.yaml").write_text("{speed: 3e-4, wheels: [{radius: 1E-1}]}")
    assert read_record(tmp_path / "cart.yaml", Cart) == cart
    assert read_mapping(tmp_path / "cart.yaml") == {"speed": 3e-4, "wheels": [{"radius": 0.1}]}


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"sped": 1.0}, r"mem: unknown key 'sped' \(did you mean 'speed'\?\); allowed are speed, wheels, spare"),
        ({}, "mem: key 'speed' is missing"),
        ({"speed": -1}, "mem: speed: .*greater than 0, got -1"),
        ({"speed": 1, "wheels": [{}]}, "mem: key 'wheels.0.radius' is missing"),
        ({"speed": 1, "wheels": [{"radius": -1}]}, "mem: wheels.0: radius must be positive, got -1.0$"),
        ({"speed": 1, "spare": {"radios": 1}}, r"unknown key 'spare.radios' \(did you mean 'radius'\?\); allowed"),
        ({"sped": 1, "colour": 2}, r"^(mem: .*\n){2}mem: .*$"),
        ([1], "mem: must be a mapping of keys to values, got list"),
    ],
)
def test_mistakes_name_source_key_and_what_is_allowed(content, message):
    with pytest.raises(ValueError, match=message):
        parse_record(content, "mem", Cart)


def bomb(first, line, repeats):
    """Return a small file with twelve lines; each line repeats the previous one several times."""
    lines = (f"a{k}: &a{k} {line.format(', '.join([f'*a{k - 1}'] * repeats))}" for k in range(1, 12))
    return "\n".join([f"a0: &a0 {first}", *lines])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a: [1", "not readable as YAML"),
        ("- 1", "mapping of keys to values"),
        ("a: 1\na: 2", "key 'a' occurs twice"),
        ("a: 2024-13-45", "not readable as YAML: month"),
        ("a: " + "9" * 5000, "number of 5,000 characters; at most 100 are allowed"),
        ("a: 0x" + "f" * 5000, "number of 5,002 characters"),
        ("a: 1" + ":59" * 60_000, "number of 180,001 characters"),
        ("a: 1" + ":59" * 60_000 + ".5", "number of 180,003 characters"),
        ("a: " + "9" * 20, "integer 9{20} has more than 64 bits"),
        ("a: !!bool perhaps", "not readable as YAML: 'perhaps'"),
        ("a: !!timestamp now", "not readable as YAML"),
        ("".join(f"k{i}: 1\n" for i in range(30_000)) + "k29999: 2", "key 'k29999' occurs twice"),
        ("a: &a [*a]", "more than 500,000 values"),
        ("a: [*a]", "found undefined alias"),
        ("a: [" + ", ".join(["[[1, 1, 1, 1], 1]"] * 80_000) + "]", "more than 500,000 values"),
        (bomb("[1, 1, 1]", "[{}]", 10), "more than 500,000 values, aliases counted each time"),
        (bomb("{k: 1, l: 2}", "{{<<: [{}]}}", 10), "more than 500,000 values, aliases counted each time"),
        (bomb("{k: 1, l: 2}", "{{<<: [{}]}}", 1000), "more than 500,000 values, aliases counted each time"),
        ("a: " + "[" * 3000 + "]" * 3000, "nested deeper than 50 levels"),
        ("a: '" + "x" * 9_000_000 + "'", "bytes; at most 8,388,608 are allowed"),
    ],
)
def test_files_that_cannot_be_read_are_named(tmp_path, text, message):
    (tmp_path / "bad.yaml").write_text(text)
    with pytest.raises(ValueError, match=rf"bad\.yaml: (.|\n)*{message}"):
        read_mapping(tmp_path / "bad.yaml")
    with pytest.raises(FileNotFoundError, match=r"gone\.yaml: no such file; there are .*bad\.yaml"):
        read_mapping(tmp_path / "gone.yaml")


@pytest.mark.parametrize(
    ("text", "content"),
    [
        ("a: &a [1, 2]\nb: [*a, *a]", {"a": [1, 2], "b": [[1, 2], [1, 2]]}),
        (
            "x: &x {a: 1, b: 2}\ny: &y {<<: *x, b: 3}\nz: {<<: [*y, {c: 4}], d: 5}",
            {"x": {"a": 1, "b": 2}, "y": {"a": 1, "b": 3}, "z": {"a": 1, "b": 3, "c": 4, "d": 5}},
        ),
        ("a: " + "1" * 200_000 + "x", {"a": "1" * 200_000 + "x"}),
    ],
)
def test_aliases_merges_and_long_texts_are_read(tmp_path, text, content):
    (tmp_path / "fine.yaml").write_text(text)
    assert read_mapping(tmp_path / "fine.yaml") == content


def test_messages_stay_short():
    with pytest.raises(ValueError, match=r"and \d+ more mistakes") as caught:
        parse_record({"speed": [1.0] * 100_000, "wheels": [{"radius": "x" * 10_000}] * 500}, "mem", Cart)
    assert len(str(caught.value)) < 5000
