"""`pickproof completion SHELL`: the completion script of a shell."""

from __future__ import annotations

from typing import Annotated, Literal

from pickproof.scenarios.commands.arguments import about


def completion(shell: Annotated[Literal["bash", "zsh", "fish"], about("the shell")], /) -> int:
    """Print the script; `eval "$(pickproof completion bash)"` enables it."""
    from pickproof.scenarios.commands.registry import build_app

    print(build_app().generate_completion(prog_name="pickproof", shell=shell))
    return 0
