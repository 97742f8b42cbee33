"""Settings of trainings: frozen dataclasses that check themselves, and go to and from JSON and checkpoints."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, ClassVar, Self, get_type_hints

from sdm.core.given_values import real, whole
from sdm.errors import FormatError, SDMError
from sdm.io.files.typed_record import as_type


@dataclass(frozen=True, kw_only=True)
class TrainingSettings:
    """Everything that decides a training but the data and the device: enough to do it again.

    A subclass is a frozen dataclass whose fields all have defaults, and whose `check` refuses what cannot be trained.
    """

    # Settings that say how long it takes, which may change when a training goes on.
    LENGTH: ClassVar[tuple[str, ...]] = ()

    def __post_init__(self) -> None:
        self.check()

    def check(self) -> None:
        """Refuse settings that cannot be trained.

        Raises:
            SDMError: Says which, and what is needed.
        """

    def record(self) -> dict[str, Any]:
        """Settings as JSON has them."""
        return {name: _plain(value) for name, value in asdict(self).items()}

    def identity(self) -> dict[str, Any]:
        """Settings that cannot change half-way, as JSON has them."""
        return {name: value for name, value in self.record().items() if name not in self.LENGTH}

    @classmethod
    def of_record(cls, record: Any, source: Path | str = "the record") -> Self:
        """Settings that `record` or `identity` gave; the default for those that were no choice then.

        Args:
            record: The settings by name.
            source: The file that they are from, for the error.

        Raises:
            FormatError: A newer sdm wrote them, or they are damaged.
        """
        if not isinstance(record, dict):
            raise FormatError(f"{source} is damaged: its settings are not a table")
        hints = get_type_hints(cls)
        unknown = set(record) - {field.name for field in fields(cls)}
        if unknown:
            names = ", ".join(sorted(map(str, unknown)))
            raise FormatError(
                f"{source} has settings that this program does not know ({names}): use the sdm that wrote it"
            )
        try:
            return cls(**{name: as_type(value, hints[name]) for name, value in record.items()})
        except (TypeError, SDMError) as error:
            raise FormatError(f"{source} is damaged, or of another sdm: {error}") from error


def check_choice(name: str, value: Any, choices: Iterable[Any]) -> None:
    """Refuse a setting that is none of the choices.

    Raises:
        SDMError: Names them.
    """
    known = list(choices)
    if not isinstance(value, str | int) or value not in known:
        raise SDMError(f"there is no {name} called {value!r}; choose one of {', '.join(map(str, known))}")


def check_counts(least: int = 1, **given: Any) -> None:
    """Refuse what is no whole number from `least` on; None too.

    Raises:
        SDMError: Names the first.
    """
    for name, value in given.items():
        if whole(value, least) is None:
            raise SDMError(f"{name.replace('_', ' ')} is {value!r}; it must be {least} or more, and whole")


def check_number(
    name: str,
    value: float | None,
    *,
    above: float = -math.inf,
    least: float = -math.inf,
    most: float = math.inf,
    below: float = math.inf,
) -> None:
    """Refuse a number out of its range, or one that is not finite; None stands for a default and passes.

    Raises:
        SDMError: Gives the range.
    """
    number = real(value)
    if value is None or (math.isfinite(number) and above < number < below and least <= number <= most):
        return
    low = [f"{least:g} or more"] if least > -math.inf else [f"more than {above:g}"] if above > -math.inf else []
    high = [f"at most {most:g}"] if most < math.inf else [f"less than {below:g}"] if below < math.inf else []
    words = " and ".join(low + high) or "finite"
    raise SDMError(f"{name.replace('_', ' ')} is {value!r}; it must be {words}")


def _plain(value: Any) -> Any:
    return [_plain(item) for item in value] if isinstance(value, list | tuple) else value
