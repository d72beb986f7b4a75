"""Compares Plumbline with published filters on recordings.

    python3 benches/accuracy/compare.py broad/*.csv.gz
    python3 benches/accuracy/compare.py --set "Nexus 5" phones/nexus5_*.csv.gz --set "TUM VI" tumvi/*.csv.gz --out table.md

Input: recordings with a reference attitude, in any format that `plumb import` reads. Arguments after `--` are passed to it.
Output: the RMSE of total, heading and inclination, degrees, per set and per recording, and the recordings in which a peer is better.
Failure: exits with 2 and the reason.
"""

from __future__ import annotations

import argparse
import json
import math
import subprocess
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from peers import BEST_OF, PEERS
from recording import METRICS, RecordingError, is_own_format, read, rmse_deg

Errors = dict[str, float]
# Smallest excess of an error that counts as worse, degrees. It is below the printed precision.
RESOLUTION_DEG = 0.005


class CompareError(ValueError):
    """A run of `plumb` that failed, or an invalid argument."""


def run_plumb(arguments: list[str]) -> str:
    """Returns the standard output of a run of `plumb`."""
    try:
        done = subprocess.run(arguments, capture_output=True, text=True, check=False)
    except OSError as cause:
        raise CompareError(f"{arguments[0]}: {cause}; build it with `cargo build --release`, or set --plumb") from cause
    if done.returncode:
        raise CompareError(f"{' '.join(arguments)}: {done.stderr.strip() or done.stdout.strip()}")
    return done.stdout


def own_errors(plumb: str, paths: list[Path], fusers: list[str]) -> dict[str, dict[str, Errors]]:
    """Returns the errors of each fuser on each recording, by the file name without extension."""
    selected = [argument for fuser in fusers for argument in ("--fuser", fuser)]
    output = run_plumb([plumb, "score", "--json", "--gnss", "off", *selected, *map(str, paths)])
    number = lambda value: math.nan if value is None else value
    return {
        stage["fuser"]: {trial["name"]: {metric: number(trial[metric]) for metric in METRICS} for trial in stage["trials"]}
        for stage in json.loads(output.splitlines()[-1])["stages"]
    }


def peer_errors(task: tuple[Path, str]) -> Errors:
    """Returns the errors of a peer on a recording."""
    path, peer = task
    recording = read(path)
    return rmse_deg(PEERS[peer](recording), recording)


def imported(plumb: str, path: Path, folder: Path, arguments: list[str]) -> Path:
    """Returns the recording itself, or its conversion to the format of Plumbline."""
    if is_own_format(path):
        return path
    out = folder / f"{path.stem}.csv.gz"
    run_plumb([plumb, "import", str(path), "-o", str(out), *arguments])
    return out


def trial_name(path: Path) -> str:
    """Returns the name that `plumb score` gives to a recording."""
    return path.name.removesuffix(".gz").removesuffix(".csv")


def mean(errors: list[Errors]) -> Errors:
    """Returns the mean of each metric over the recordings that have it."""
    known = {metric: [e[metric] for e in errors if math.isfinite(e[metric])] for metric in METRICS}
    return {metric: sum(values) / len(values) if values else math.nan for metric, values in known.items()}


def cell(errors: Errors) -> str:
    """Formats total, heading and inclination."""
    return " / ".join(f"{errors[metric]:.2f}" if math.isfinite(errors[metric]) else "–" for metric in METRICS)


def worse(own: Errors, peers: dict[str, Errors]) -> list[str]:
    """Describes the metrics in which the best peer has a smaller error than `own`."""
    found = []
    for metric in METRICS:
        known = {peer: errors[metric] for peer, errors in peers.items() if peer in BEST_OF and math.isfinite(errors[metric])}
        best = min(known, key=known.__getitem__, default=None)
        if best is not None and own[metric] > known[best] + RESOLUTION_DEG:
            found.append(f"{metric} {own[metric]:.2f}°, {best} {known[best]:.2f}°")
    return found


def report(sets: dict[str, list[str]], errors: dict[str, dict[str, Errors]], first: str) -> str:
    """Returns the tables and the list of recordings in which a peer is better than the fuser `first`."""
    head = ["", *errors]
    rows = [head, ["---"] * len(head)]
    for name, trials in sets.items():
        rows.append([f"**{name}**", *(f"**{cell(mean([of[trial] for trial in trials]))}**" for of in errors.values())])
        rows += [[trial, *(cell(of[trial]) for of in errors.values())] for trial in trials]
    lines = ["RMSE, degrees: total / heading / inclination. Bold: mean of the set.", ""]
    lines += [f"| {' | '.join(row)} |" for row in rows]
    lines += ["", f"Recordings in which the best of {', '.join(BEST_OF)} is better than {first}:", ""]
    peers = lambda trial: {peer: of[trial] for peer, of in errors.items() if peer in PEERS}
    listed = [(trial, worse(errors[first][trial], peers(trial))) for trials in sets.values() for trial in trials]
    lines += [f"- {trial}: {'; '.join(found)}" for trial, found in listed if found] or ["- none"]
    return "\n".join(lines) + "\n"


def sets_of(arguments: argparse.Namespace) -> dict[str, list[Path]]:
    """Returns the recordings of each set. Without `--set`, a set is a folder."""
    sets: dict[str, list[Path]] = {}
    for path in arguments.recordings:
        sets.setdefault(path.resolve().parent.name, []).append(path)
    for name, *paths in arguments.set:
        sets.setdefault(name, []).extend(map(Path, paths))
    paths = [path for members in sets.values() for path in members]
    if not paths:
        raise CompareError("no recordings; name files, or use --set NAME FILE…")
    names = [trial_name(path) for path in paths]
    duplicate = next((name for name in names if names.count(name) > 1), None)
    if duplicate:
        raise CompareError(f"two recordings are named {duplicate}; rename one of the files")
    return sets


def compare(arguments: argparse.Namespace) -> tuple[dict[str, list[str]], dict[str, dict[str, Errors]]]:
    """Returns the names of the recordings of each set, and the errors of each filter on each recording."""
    sets = sets_of(arguments)
    with tempfile.TemporaryDirectory() as folder:
        converted = {
            name: [imported(arguments.plumb, path, Path(folder), arguments.import_arguments) for path in paths]
            for name, paths in sets.items()
        }
        paths = [path for members in converted.values() for path in members]
        errors = own_errors(arguments.plumb, paths, arguments.fuser)
        tasks = [(path, peer) for peer in PEERS for path in paths]
        with ProcessPoolExecutor(arguments.jobs) as pool:
            for (path, peer), found in zip(tasks, pool.map(peer_errors, tasks)):
                errors.setdefault(peer, {})[trial_name(path)] = found
        return {name: [trial_name(path) for path in members] for name, members in converted.items()}, errors


def main() -> int:
    """Runs the comparison."""
    own, separator, import_arguments = sys.argv[1:], "--", []
    if separator in own:
        own, import_arguments = own[: own.index(separator)], own[own.index(separator) + 1 :]
    parser = argparse.ArgumentParser(description="Compare Plumbline with published filters on recordings")
    parser.add_argument("recordings", nargs="*", type=Path, help="recordings with a reference attitude")
    parser.add_argument("--set", nargs="+", action="append", default=[], metavar=("NAME", "FILE"), help="recordings of a set")
    parser.add_argument("--fuser", action="append", help="fuser of Plumbline, repeatable [default: multiple-model, vqf]")
    parser.add_argument("--plumb", default="target/release/plumb", help="executable [default: %(default)s]")
    parser.add_argument("--jobs", type=int, help="number of processes [default: all cores]")
    parser.add_argument("--out", type=Path, help="also write the table to this file")
    parser.add_argument("--json", action="store_true", help="print the errors as JSON")
    arguments = parser.parse_args(own)
    arguments.fuser, arguments.import_arguments = arguments.fuser or ["multiple-model", "vqf"], import_arguments
    try:
        sets, errors = compare(arguments)
    except (CompareError, RecordingError, OSError) as cause:
        print(f"compare.py: {cause}", file=sys.stderr)
        return 2
    text = report(sets, errors, arguments.fuser[0])
    if arguments.out:
        arguments.out.write_text(text, encoding="utf-8")
    defined = lambda of: {metric: error if math.isfinite(error) else None for metric, error in of.items()}
    as_json = {name: {trial: defined(of) for trial, of in trials.items()} for name, trials in errors.items()}
    print(json.dumps({"sets": sets, "errors": as_json}) if arguments.json else text, end="\n" if arguments.json else "")
    return 0


if __name__ == "__main__":
    sys.exit(main())
