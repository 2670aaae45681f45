"""The schema of `params.yaml` is current, and says yes and no where the reader does."""

import json

import pytest
from click.testing import CliRunner
from jsonschema import Draft202012Validator

from porse.cli import main
from porse.config import parse_params
from porse.errors import ParamsError
from porse.schema import FILE, rendered, schema
from tiny import committed_params


def holds(document):
    return Draft202012Validator(schema()).is_valid(document)


def test_the_committed_schema_is_current_and_params_yaml_names_it(root, monkeypatch):
    monkeypatch.chdir(root)
    assert (root / FILE).read_text() == rendered()
    assert (root / "params.yaml").read_text().startswith(f"# yaml-language-server: $schema={FILE}\n")
    assert CliRunner().invoke(main, ["schema", "--check"]).exit_code == 0


def test_another_file_is_not_current(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / FILE).write_text(json.dumps({}))
    done = CliRunner().invoke(main, ["schema", "--check"])
    assert (done.exit_code, "run `porse schema`" in done.output) == (1, True)


def test_an_editor_can_say_what_a_section_is_about():
    document = schema()
    assert document["properties"]["fuse"] == {"$ref": "#/$defs/FuseParams"}
    assert document["$defs"]["FuseParams"]["description"] == "What an iteration hands to the next one."


def test_the_committed_parameters_hold():
    assert holds(committed_params())


CHANGES = {
    "a range": ("train", "gamma", 1.5),
    "a type": ("generate", "candidates", "six"),
    "a choice": ("exploration", "form", "litteral"),
    "a word of Python": ("exploration", "lambda", -0.5),
    "null where no preset gives a value": ("candidate", "beta", None),
    "an empty list": ("train", "hidden", []),
    "a key that is none": ("train", "gama", 0.9),
}


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
def test_what_the_reader_refuses_the_schema_refuses(change):
    section, key, value = change
    document = committed_params()
    document[section] = {**document[section], key: value}
    with pytest.raises(ParamsError):
        parse_params(document, "here")
    assert not holds(document)


def test_a_key_that_is_missing_and_a_method_that_is_none_are_refused():
    document = committed_params()
    assert not holds({**document, "method": "eurika"})
    assert holds({**document, "method": "eureka"})
    del document["seed"]
    assert not holds(document)
