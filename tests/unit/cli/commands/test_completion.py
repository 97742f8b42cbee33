"""`sdm completion`: a script for the shell, or one sentence."""

from __future__ import annotations

import pytest

from sdm.cli import main


def test_a_shell_whose_completion_needs_another_package(monkeypatch, capsys):
    def missing(words: list[str]) -> int:
        raise ImportError("shtab is required for completion generation")

    monkeypatch.setattr("sdm.cli.app.main", missing)
    assert main is not missing
    from sdm.cli.commands.setup.completion import completion
    from sdm.errors import SDMError

    with pytest.raises(SDMError, match="completion in tcsh needs shtab, which is not installed: pip install shtab"):
        completion("tcsh")


@pytest.mark.parametrize("shell", ["bash", "zsh"])
def test_a_script_for_the_shell(shell, capsys):
    assert main(["completion", shell]) == 0
    assert "sdm" in capsys.readouterr().out
