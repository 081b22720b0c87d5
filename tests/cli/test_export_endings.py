"""A policy is exported under a name by which its format is known again."""

from __future__ import annotations

import pytest

from hts.cli.main import main


@pytest.mark.parametrize(
    ("to", "form", "said"),
    [
        ("x.foo", [], "--to x.foo: ends in '.foo', a policy as onnx in .onnx. Name the file so"),
        ("x", [], "--to x: has no ending, a policy as onnx ends in .onnx. Name the file so"),
        ("x.pt", [], "ends in '.pt', a policy as onnx in .onnx. Name the file so, or say --format torchscript."),
        (
            "x.onnx",
            ["--format", "torchscript"],
            "as torchscript in .pt, .pth, .jit, .ts or .torchscript. Name the file",
        ),
    ],
)
def test_a_policy_is_exported_under_an_ending_of_its_format(to, form, said, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.safetensors").write_text("read only after its new name was looked at")
    assert main(["export", "--policy", "mine.safetensors", "--to", to, *form]) == 2
    assert said in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["mine.safetensors"]


@pytest.mark.parametrize(
    ("to", "form"), [("x.onnx", "onnx"), *((f"x.{end}", "torchscript") for end in ("pt", "jit", "ts", "torchscript"))]
)
def test_the_endings_of_each_format_are_taken(to, form, capsys, tmp_path):
    missing = str(tmp_path / "gone.safetensors")
    assert main(["export", "--policy", missing, "--to", str(tmp_path / to), "--format", form]) == 2
    assert "gone.safetensors: expected a policy file that exists" in capsys.readouterr().err
