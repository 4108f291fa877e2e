"""Conditions of results, to be quoted with every number."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from bus_schema.messages.run_event import EventKind
from bus_schema.messages.topics import Role
from bus_schema.runtime.realtime import AFFINITY, SCHEDULER
from deploy.judge.run_data import RunData
from deploy.scenario.setup import Setup
from plant_emulator.channel.trace_file import read_trace
from plant_emulator.physics.engines import DEFAULT_ENGINE, ENGINES, default_note, physics_in_force

Conditions = dict[str, str]
"""Sentences or numbers with their unit, by subject."""

EFFORT = "effort"
"""Name of the condition that says on how many starts, seeds and seconds a number rests."""
_UNKNOWN = "not known"
_GRANTED_IN_SILENCE = (
    f"{_UNKNOWN}: not in the manifest, for example because the processes were started separately"
)
_SHOWN_GRANTS = (SCHEDULER, AFFINITY)


def conditions_of_runs(setups: Sequence[Setup], manifest: Mapping[str, Any]) -> Conditions:
    """Return the conditions of a run, or of runs that differ only in their law.

    Args:
        setups: the scenario, with each law.
        manifest: ``manifest.json`` of the folder; empty where there is none.
    """
    scenario, laws = setups[0].scenario, [setup.scenario.controller.name for setup in setups]
    start = ", ".join(f"{offset:g}" for offset in scenario.robot.initial_offset_rad)
    return {
        **provenance_of(manifest),
        "scenario": scenario.name,
        "law": ", ".join(laws),
        "physics": _physics_of(setups),
        **drives_of(setups),
        **networks_of(_traces_of(setups)),
        "duration": f"{scenario.duration_s:g} s",
        "starts": f"initial offset {start} rad",
        "seeds": seeds_text([scenario.seed]),
        "set": _UNKNOWN if manifest.get("set") is None else ", ".join(manifest["set"]) or "nothing",
        **host_of(manifest),
        **_extensions_of(manifest),
        **_warnings_of(manifest),
    }


def conditions_of_recording(run: RunData, manifest: Mapping[str, Any]) -> Conditions:
    """Return the conditions of a recorded run.

    Args:
        run: its data.
        manifest: ``manifest.json`` of the folder; empty where there is none.
    """
    conditions = {**conditions_of_runs([run.setup], manifest), "law": run.controller}
    if physics := run.last_values(Role.PLANT, EventKind.ENDED).get("physics"):
        has_rotors = run.setup.scenario.plant.actuator.has_rotors  # known only to one engine
        note = "" if has_rotors else _note_of_default(physics, manifest)
        conditions["physics"] = physics + note
    if run.clock == "realtime" and not manifest.get("realtime"):
        conditions["granted"] = _GRANTED_IN_SILENCE
    return conditions


def _physics_of(setups: Sequence[Setup]) -> str:
    """Return engine and integrator of the plants."""
    plants = [setup.scenario.plant for setup in setups]
    return ", ".join(dict.fromkeys(physics_in_force(each) + default_note(each) for each in plants))


def seeds_text(seeds: Sequence[int], most: int = sys.maxsize) -> str:
    """Return how many seeds there are, and which; of more than `most` the first and the last."""
    texts = list(map(str, seeds))
    if len(texts) == 1:
        return f"one (seed {texts[0]})"
    shown = ", ".join(texts) if len(texts) <= most else f"{texts[0]} … {texts[-1]}"
    return f"{len(texts)} (seeds {shown})"


def drives_of(setups: Sequence[Setup]) -> Conditions:
    """Return the sources of the motors' and friction's numbers, if scenarios name them."""
    sources = dict.fromkeys(setup.drive_data for setup in setups)
    return {"drives": "; ".join(filter(None, sources))} if any(sources) else {}


def _traces_of(setups: Sequence[Setup]) -> list[Path]:
    ways = [way for setup in setups for way in (setup.link.uplink, setup.link.downlink)]
    return [Path(way.trace.file) for way in ways if way.trace is not None]


def networks_of(files: Iterable[Path]) -> Conditions:
    """Return what is assumed of files of other programs that are replayed; shipped traces: none."""
    found = {file: read_trace(file).assumed for file in dict.fromkeys(files) if file.is_file()}
    text = "; ".join(f"{file.name}: {assumed}" for file, assumed in found.items() if assumed)
    return {"network": text} if text else {}


def _note_of_default(physics: str, manifest: Mapping[str, Any]) -> str:
    """Note that a recorded run used another engine than the default one, without choosing it."""
    section: Any = manifest
    for key in ("scenario", "plant", "physics"):  # older manifests lack the last one
        section = section.get(key) if isinstance(section, dict) else None
    title = ENGINES[DEFAULT_ENGINE].title
    was_chosen = not isinstance(section, dict) or section.get("engine") is not None
    return "" if was_chosen or physics.startswith(title) else f" ({title} was not installed)"


def provenance_of(manifest: Mapping[str, Any]) -> Conditions:
    """Return versions and dates; several for results that have grown."""
    return {
        "version": _each(manifest, _version_text),
        "date": _each(manifest, lambda made: str(made.get("started", _UNKNOWN))),
    }


def _warnings_of(manifest: Mapping[str, Any]) -> Conditions:
    """Return warnings about missing or suspicious contents of the arm's file."""
    known = manifest.get("warnings")
    return {"warnings": "; ".join(map(str, known))} if known and isinstance(known, list) else {}


def _extensions_of(manifest: Mapping[str, Any]) -> Conditions:
    """Return the entries of installed packages that the runs used."""
    known = manifest.get("extensions")
    is_list = isinstance(known, list) and known
    return {"extensions": ", ".join(map(str, known or ()))} if is_list else {}


def host_of(manifest: Mapping[str, Any]) -> Conditions:
    """Return the machine, and the settings that it granted."""
    grants = manifest.get("realtime") or {}
    granted = [f"{role} {_grants_text(settings)}" for role, settings in grants.items()]
    return {
        "host": _each(manifest, _host_text),
        "granted": "; ".join(granted)
        or ("no real-time permissions, because no loop ran in real time"),
    }


def lacked_grants(manifest: Mapping[str, Any]) -> list[str] | None:
    """Return the grants that one of the loops lacked; None if the manifest names none at all."""
    grants = manifest.get("realtime") or {}
    settings = [setting for of_role in grants.values() for setting in of_role]
    lacked = {setting["name"] for setting in settings if not setting["granted"]}
    return [name for name in _SHOWN_GRANTS if name in lacked] if grants else None


def conditions_line(conditions: Mapping[str, str]) -> str:
    """Return all conditions on one line, to stand below a table."""
    return "Conditions: " + "; ".join(f"{name}: {text}" for name, text in conditions.items()) + "."


def _each(manifest: Mapping[str, Any], tell: Callable[[Mapping[str, Any]], str]) -> str:
    """Return the values of the first results and of all added ones, each once."""
    made = [*manifest.get("grown_from", ()), manifest]
    return ", then ".join(dict.fromkeys(tell(each) for each in made))


def _version_text(manifest: Mapping[str, Any]) -> str:
    return f"funnel-hil {manifest.get('versions', {}).get('funnel-hil') or _UNKNOWN}"


def _host_text(manifest: Mapping[str, Any]) -> str:
    host = manifest.get("host")
    if not host:
        return _UNKNOWN
    usable = host.get("usable_cpus", host["cpus"])
    return f"{host['machine']}, kernel {host['kernel']}, {usable} of {host['cpus']} CPUs usable"


def _grants_text(settings: Sequence[Mapping[str, Any]]) -> str:
    """Describe a process's grants that matter most for its deadlines."""
    by_name = {setting["name"]: setting for setting in settings}
    asked = [by_name[name] for name in _SHOWN_GRANTS if name in by_name] or settings
    return ", ".join(one["detail"] if one["granted"] else f"no {one['name']}" for one in asked)
