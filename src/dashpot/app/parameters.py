"""Values that the command line gives to parameters and inputs of a rig, in SI units."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from dashpot.errors import Problem, UsageError
from dashpot.quantities import quantity_of_unit

if TYPE_CHECKING:
    from dashpot.model.network import Model
    from dashpot.model.rigfile import Rig
    from dashpot.quantities import Amount


def merged(settings: Sequence[Mapping[str, Amount]], option: str) -> dict[str, Amount]:
    """The settings of an option that may be repeated, each name given once.  Raises UsageError."""
    everything: dict[str, Amount] = {}
    for setting in settings:
        for name, value in setting.items():
            if name in everything:
                raise UsageError(f"{option} gives {name} twice", cure="give it once")
            everything[name] = value
    return everything


def parameter_values(
    rig: Rig, settings: Sequence[Mapping[str, Amount]], *, whole: bool = False
) -> dict[str, float]:
    """Values of unknowns from --set, in SI units; with `whole`, each has one there or in the rig file.

    Raises UsageError with every name or unit that is wrong, or every unknown without a value.
    """
    unknown = {unknown.name: unknown for unknown in rig.model.unknowns}
    elements = {element.name for element in rig.model.elements}
    problems, values = [], {}
    for name, amount in merged(settings, "--set").items():
        if name in unknown:
            values[name] = _in_si(name, amount, unknown[name].unit, "--set")
        elif name in elements:
            cure = "change it there, or leave it out here"
            problems.append(Problem(f"--set {name}: the rig file gives its value", rig.path, cure))
        else:
            what = f"--set: {name!r} is not an unknown of this rig"
            problems.append(Problem(what, rig.path, f"its unknowns are {', '.join(unknown)}"))
    if whole and not problems:
        problems = [
            Problem(f"{name} has no value", rig.path, f"add --set {name}=1.0, or a guess in the rig file")
            for name, one in unknown.items()
            if name not in values and one.prior is None and one.guess is None
        ]
    if problems:
        raise UsageError(problems)
    return values


def true_values(rig: Rig, settings: Mapping[str, Amount]) -> dict[str, float]:
    """True values of --truth in SI units; those of gains and delays are taken as they are.  Raises UsageError."""
    unit = {unknown.name: unknown.unit for unknown in rig.model.unknowns}
    return {name: _in_si(name, amount, unit.get(name, "1"), "--truth") for name, amount in settings.items()}


def _in_si(name: str, amount: Amount, unit: str, option: str) -> float:
    kind = quantity_of_unit(unit)
    if amount.unit is None:
        return amount.number
    if kind is None:
        raise UsageError(f"{option} {name}={amount}: {name} has no unit", cure="write the number alone")
    try:
        return amount.si(*kind)
    except UsageError as error:
        raise UsageError(
            f"{option} {name}={amount}: {error.problems[0].what}", cure=error.problems[0].cure
        ) from None


def input_is_angular(model: Model) -> bool:
    """Whether the inputs are angles or torques."""
    points = {*model.displacement_inputs, *(point for source in model.inputs for point in source.at)}
    return bool(points) and points <= set(model.angles)


def drive_amplitude(model: Model, given: Amount | Mapping[str, Amount]) -> float:
    """One amplitude for the drive, in m or rad where the rig is moved, in N or N·m where it is pushed.

    Raises UsageError where inputs are named and their amplitudes differ, for what is designed is one drive.
    """
    if isinstance(given, Mapping):
        sizes = set(input_amplitudes(model, [given]).values())
        if len(sizes) > 1:
            raise UsageError(
                "--amplitude gives the inputs different amplitudes", cure="give one for the drive"
            )
        return sizes.pop()
    kind = "displacement" if model.displacement_inputs else "force"
    return given.si(kind, input_is_angular(model))


def input_amplitudes(model: Model, settings: Sequence[Amount | Mapping[str, Amount]]) -> dict[str, float]:
    """Amplitudes by input, SI units: "5 mm" is that of every input, "u=5 mm" that of one.  Raises UsageError."""
    inputs = [*model.displacement_inputs, *model.force_inputs]
    named = merged([source for source in settings if isinstance(source, Mapping)], "--amplitude")
    common = [source for source in settings if not isinstance(source, Mapping)]
    if len(common) > 1:
        raise UsageError("--amplitude is given twice for all inputs", cure="give it once")
    for name in named:
        if name not in inputs:
            raise UsageError(
                f"--amplitude: {name!r} is not an input of this rig",
                cure=f"its inputs are {', '.join(inputs)}",
            )
    amplitudes = {}
    for source in model.inputs:
        given = named.get(source.name, common[0] if common else None)
        if given is not None:
            moved = source.kind == "displacement"
            turned = {source.name} if moved else set(source.at)
            kind = "displacement" if moved else "force"
            amplitudes[source.name] = given.si(kind, turned <= set(model.angles))
    return amplitudes
