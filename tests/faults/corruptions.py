"""Damage files of every kind in every way, read them as the commands do, and count what comes of it.

    python -m tests.faults.corruptions            # writes tests/faults/corruptions.json

A: an error that names the file (a damaged cell is named, and not counted). unaffected: the same result as before. B: an
error without the file's name. C: a traceback, a hang or the end of the process. D: another result, without a word.
"""

from __future__ import annotations

import json
import os
import random
import resource
import shutil
import sys
import tempfile
import tomllib
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pandas as pd
import torch

from agents import pretrained
from agents.files import DamagedFile, load_arrays, save_arrays
from agents.greedy import Greedy
from agents.models import DuelingMLP
from experiments.analysis.analysis import analyse
from experiments.reporting.page import page, render
from experiments.study.design.grid import cell_name
from experiments.study.results import packed, store
from experiments.study.results.store import load
from experiments.support.errors import UserError
from experiments.support.files import sha256_bytes, sha256_file
from sumo_env.config import ConfigError
from sumo_env.env import SumoDrivingEnv
from sumo_env.simulator import SimulatorError
from tests.faults import judged
from tests.sumo_env.scenario.files import written

ROOT = Path(__file__).resolve().parents[2]
TABLE = Path(__file__).with_name("corruptions.json")
JUDGED = Path(__file__).with_name("judged.toml")
SAID = (UserError, DamagedFile, ConfigError, SimulatorError, ValueError, FileNotFoundError)
PATIENCE, MEMORY = 60, 8 * 2**30  # [s] of the processor, and bytes, of a read
NOBODY = 65534  # who reads where the campaign runs as root: for root nothing is unreadable
STATES = ("A", "unaffected", "B", "C", "D")
Case = tuple[str, Path, Callable[[], object], Callable[[], Any]]  # name, file, damage, read


# -- damage ------------------------------------------------------------------------------------------------


def spoilt(file: Path) -> dict[str, Callable[[], object]]:
    """Ways to damage any file, by name."""
    content, rng = file.read_bytes(), random.Random(file.name)

    def instead(make: Callable[[], object]) -> Callable[[], None]:
        def act() -> None:
            file.unlink()
            make()

        return act

    def put(data: bytes) -> Callable[[], None]:
        return instead(lambda: file.write_bytes(data))

    ways: dict[str, Callable[[], object]] = {
        "cut in half": put(content[: len(content) // 2]),
        "cut by a byte": put(content[:-1]),
        "cut to ten": put(content[:10]),
        "empty": put(b""),
        "noise": put(rng.randbytes(len(content) or 100)),
        "missing": instead(lambda: None),
        "folder": instead(file.mkdir),
        "pipe": instead(lambda: os.mkfifo(file)),
        "device": instead(lambda: file.symlink_to("/dev/zero")),
        "link to itself": instead(lambda: file.symlink_to(file.name)),
        "unreadable": lambda: file.chmod(0),
        "sparse": lambda: os.truncate(file, 2**41),
    }
    for number in range(4):
        place = rng.randrange(len(content))
        ways[f"flip {number}"] = put(
            content[:place] + bytes([content[place] ^ (1 << number)]) + content[place + 1 :]
        )
    if file.suffix == ".json":
        ways |= {"a list": put(b"[1, 2]"), "nested": put(b"[" * 100_000), "null": put(b"null")}
    return ways


def first_row(table: pd.DataFrame, column: str, value: Any) -> pd.DataFrame:
    changed = table.copy()
    if isinstance(value, str | float):
        changed[column] = changed[column].astype(str if isinstance(value, str) else float)
    changed.loc[0, column] = value
    return changed


Change = Callable[[dict[str, Any], dict[str, pd.DataFrame]], None]  # of records by cell, and tables


def of_record(change: Callable[[dict[str, Any]], object], agent: bool = True) -> Change:
    def act(records: dict[str, Any], tables: dict[str, pd.DataFrame]) -> None:
        name = next(n for n, r in records.items() if (r["key"]["kind"] == "agent") == agent)
        change(records[name])

    return act


def of_table(file: str, change: Callable[[pd.DataFrame], pd.DataFrame]) -> Change:
    def act(records: dict[str, Any], tables: dict[str, pd.DataFrame]) -> None:
        tables[file] = change(tables[file])

    return act


def without(keep: Callable[[Mapping[str, Any]], bool]) -> Change:
    def act(records: dict[str, Any], tables: dict[str, pd.DataFrame]) -> None:
        for name in [name for name, record in records.items() if not keep(record["key"])]:
            del records[name]

    return act


def take_out(path: str, record: dict[str, Any]) -> None:
    part, _, entry = path.rpartition(".")
    del (record[part] if part else record)[entry]


def is_other(policy: str, key: Mapping[str, Any]) -> bool:
    return bool(key["policy"] != policy)


def wrong_contents() -> dict[str, Change]:
    """Tables and records that somebody has written with right checksums, and right names."""
    found: dict[str, Change] = {}
    for path, odd in judged.RECORDS.items():
        for value in odd:
            found[f"{path}={value!r}"[:60]] = of_record(partial(judged.deep, path=path, new=value))
    for path in judged.NEEDED:
        found[f"no {path}"] = of_record(partial(take_out, path))
    wrong_rows: dict[str, Any] = {
        "traffic": "storm",
        "scenario": -1,
        "return": float("nan"),
        "length": 0,
        "crashed": "perhaps",
        "mean_speed": float("inf"),
        "distance": float("nan"),
        "near_misses": 10_000,
        "action_0": -3,
    }
    for file in (store.EPISODES, store.GATES):
        for column, value in wrong_rows.items():
            found[f"{file} {column}={value!r}"] = of_table(
                file, partial(first_row, column=column, value=value)
            )
            found[f"{file} no {column}"] = of_table(file, partial(pd.DataFrame.drop, columns=column))
        found[f"{file} twice"] = of_table(file, lambda t: pd.concat([t, t], ignore_index=True))
        found[f"{file} half of the scenarios"] = of_table(file, lambda t: t[t["scenario"] % 2 == 0])
        found[f"{file} a cell without rows"] = of_table(file, lambda t: t[t["cell"] != t["cell"].iloc[0]])
        found[f"{file} a row less"] = of_table(file, lambda t: t.iloc[1:])
        found[f"{file} no rows"] = of_table(file, lambda t: t.iloc[:0])
        found[f"{file} no cell"] = of_table(file, lambda t: t.drop(columns="cell"))
        found[f"{file} all text"] = of_table(file, lambda t: t.astype(str))
    more = {
        "min_ttc": -1.0,
        "density": float("nan"),
        "stopped": 2.0,
        "crash_time": -1.0,
        "crash_x": float("inf"),
    }
    for column, value in more.items():
        found[f"episodes {column}={value}"] = of_table(
            store.EPISODES, partial(first_row, column=column, value=value)
        )
    found["control alone"] = without(lambda k: k["arm"] != "treatment")
    found["treatment alone"] = without(lambda k: k["arm"] != "control")
    found["one agent alone"] = without(lambda k: k["arm"] == "control" and k["seed"] == 0)
    found["one agent in each arm"] = without(lambda k: k["seed"] in (0, None))
    found["one agent less"] = without(lambda k: (k["arm"], k["seed"]) != ("control", 0))
    for policy in ("careful", "slower", "idle", "random", "faster", "idm"):
        found[f"no {policy}"] = without(partial(is_other, policy))
    found["no baselines"] = without(lambda k: k["kind"] == "agent")
    found["baselines alone"] = without(lambda k: k["kind"] != "agent")
    for way, of_rows in judged.TABLES.items():
        found[f"rows: {way}"] = of_table(store.EPISODES, of_rows)
    return found


def rewrite(folder: Path, change: Change) -> None:
    """Change packed cells: the names follow the records where these still make one, the checksums the tables."""
    index = pd.read_parquet(folder / packed.CELLS)
    records = {name: json.loads(text) for name, text in zip(index["cell"], index["record"], strict=True)}
    tables = {file: pd.read_parquet(folder / file) for file in (store.EPISODES, store.GATES)}
    before = {name: json.dumps(record) for name, record in records.items()}
    change(records, tables)
    names = {}
    for name, record in records.items():
        names[name] = name
        if json.dumps(record) != before[name]:
            try:
                names[name] = cell_name(record["key"], record["versions"])
            except Exception:  # it has none
                continue
    texts = [json.dumps(records[name]).replace('"~"', "1e999") for name in names]
    index = pd.DataFrame({"cell": [*names.values()], "record": texts})
    index.to_parquet(folder / packed.CELLS)
    sums = {packed.CELLS: [sha256_file(folder / packed.CELLS)]}
    for file, table in tables.items():
        if isinstance(table, pd.DataFrame) and "cell" in table:
            table = table[table["cell"].isin(names)].assign(cell=lambda t: t["cell"].map(names))
        judged.write_table(folder / file, table)
        sums[file] = [sha256_file(folder / file)]
    (folder / packed.MANIFEST).write_text(json.dumps({"layout": 1, "files": sums}))


# -- reading -----------------------------------------------------------------------------------------------


def digest(value: Any) -> str:
    """The same for the same content."""
    if isinstance(value, pd.DataFrame):
        value = value.to_csv()
    elif isinstance(value, np.ndarray):
        value = value.tolist()
    return sha256_bytes(str(value).encode())


def results_of(folder: Path, report: bool = False) -> str:
    """All that is read; with a report its words, without where it is."""
    packed._records.cache_clear()
    packed._tables.cache_clear()
    try:
        return words_of(folder) if report else contents_of(folder)
    except ValueError as error:
        raise AssertionError(f"a command would end in a traceback: {error}") from error


def contents_of(folder: Path) -> str:
    found = loaded(folder)
    return digest(found.episodes) + digest(found.gate_episodes) + digest(found.cells)


def loaded(folder: Path) -> store.Results:
    found = load(folder)
    if found.damaged:
        raise UserError(next(iter(found.damaged.values())))
    return found


def words_of(folder: Path) -> str:
    found = loaded(folder)
    analysis = analyse(found)
    words = render(page(found, analysis, {}), "report.html.j2")
    if "cannot be compared in full" in words or "are not counted" in words:
        raise UserError(f"{folder}: it stands in the report")
    return digest(words)


def small(folder: Path) -> None:
    """Two agents an arm and the baselines of one setting of a published study, packed."""
    shutil.copytree(ROOT / "results" / "linear", folder, ignore=shutil.ignore_patterns("*.html", "*.md"))
    rewrite(folder, without(lambda key: key["task"] == "highway" and key["seed"] in (0, 1, None)))
    (folder / store.SWEEPS).write_text(json.dumps({"sweeps": [{"command": "sweep", "cells": []}]}))


def unpacked(folder: Path, source: Path) -> Path:
    """The same with a folder for each cell; returns one of an agent."""
    for name, record in packed.packed_records(source).items():
        cell = folder / "cells" / name
        cell.mkdir(parents=True)
        for file in (store.EPISODES, store.GATES):
            packed.packed_tables(source, file)[name].to_parquet(cell / file)
        files = {file: sha256_file(cell / file) for file in (store.EPISODES, store.GATES)}
        (cell / store.CELL).write_bytes(store.seal({**record, "files": files}))
    return next(cell for cell in sorted((folder / "cells").iterdir()) if "control" in cell.name)


def replaced(file: Path) -> dict[str, Callable[[], object]]:
    """Changes of one of SUMO's files, as judged.toml has them."""
    text = file.read_text()
    listed: dict[str, list[str]] = tomllib.loads(JUDGED.read_text())[file.name]
    assert not [way for way, (old, _) in listed.items() if old not in text]
    return {way: partial(file.write_text, text.replace(old, new)) for way, (old, new) in listed.items()}


def driven(folder: Path, **more: Any) -> str:
    """Some steps of an episode among SUMO's traffic."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        env = SumoDrivingEnv(folder / "t.sumocfg", ego_vehicle="ego", **more)
        observation, _ = env.reset(seed=0)
        seen = [observation.tolist()]
        for _ in range(5):
            observation, reward, *_ = env.step(1)
            seen.append([observation.tolist(), reward])
        env.close()
        return digest(seen)


def agent_file(folder: Path) -> Path:
    """One published agent with its card."""
    with np.load(pretrained.FILE) as stored:
        arrays = {name: stored[name] for name in stored.files if name.startswith("u-turn-3/control/")}
        card = json.loads(str(stored[pretrained.CARDS]))["u-turn-3/control"]
    file = folder / "agents.npz"
    save_arrays(file, {**arrays, pretrained.CARDS: np.array(json.dumps({"u-turn-3/control": card}))})
    return file


def of_arrays(file: Path) -> dict[str, Callable[[], None]]:
    """Ways to write an npz with wrong contents."""
    arrays = load_arrays(file)
    name = next(name for name, array in arrays.items() if array.dtype.kind == "f" and array.size > 1)

    def put(**changes: Any) -> Callable[[], None]:
        kept = {k: v for k, v in {**arrays, **changes}.items() if v is not None}
        return lambda: save_arrays(file, kept)

    ways = {
        "a weight is nan": put(**{name: np.full_like(arrays[name], np.nan)}),
        "a weight is infinite": put(**{name: np.full_like(arrays[name], np.inf)}),
        "a weight is missing": put(**{name: None}),
        "another shape": put(**{name: arrays[name][..., :-1]}),
        "text for a weight": put(**{name: np.array("weights")}),
    }
    for text in ("cards", "settings"):
        if text in arrays:
            ways |= {
                f"no {text}": put(**{text: None}),
                f"{text} a list": put(**{text: np.array("[1]")}),
                f"{text} no JSON": put(**{text: np.array("{")}),
            }
    return ways


def cases(home: Path) -> Iterator[Case]:
    """Everything that is tried; each begins with a fresh copy of `home`."""
    folder, cells = home / "packed", home / "cells"
    small(folder)
    agent = unpacked(cells, folder)
    for name in (packed.MANIFEST, packed.CELLS, store.EPISODES, store.GATES, store.SWEEPS):
        for way, damage in spoilt(folder / name).items():
            yield f"packed {name}: {way}", folder / name, damage, lambda: results_of(folder)
    for name in (store.CELL, store.EPISODES, store.GATES):
        for way, damage in spoilt(agent / name).items():
            yield f"cell {name}: {way}", agent / name, damage, lambda: results_of(cells)
    for way, change in wrong_contents().items():
        yield (
            f"contents: {way}",
            folder,
            partial(rewrite, folder, change),
            lambda: results_of(folder, report=True),
        )
    file = agent_file(home)
    observation = np.random.default_rng(0).normal(size=(5, 5)).astype(np.float32)

    def values() -> str:
        policy = pretrained.load("u-turn-3", "control", file)
        shape = pretrained.card("u-turn-3", "control", file)["observations"]
        policy.q(np.zeros(shape, np.float32))
        return digest([w.tolist() for w in policy.network.state_dict().values()])

    for way, damage in {
        **spoilt(file),
        **of_arrays(file),
        **judged.archives(file),
        **judged.odd_cards(file),
    }.items():
        yield f"agents.npz: {way}", file, damage, values
    weights, space = home / "weights.npz", gym.spaces.Box(-1, 1, (5, 5), np.float32)
    torch.manual_seed(0)
    Greedy(DuelingMLP(space, 5)).save(weights)
    for way, damage in {**spoilt(weights), **of_arrays(weights)}.items():
        yield (
            f"weights.npz: {way}",
            weights,
            damage,
            lambda: digest(Greedy.load(weights, DuelingMLP(space, 5)).q(observation)),
        )
    town = written(home / "town", "static").parent
    for name in ("grid.net.xml", "t.rou.xml", "t.sumocfg", "t.add.xml"):
        for way, damage in {**spoilt(town / name), **replaced(town / name)}.items():
            yield f"SUMO {name}: {way}", town / name, damage, lambda: driven(town)


def outcome(read: Callable[[], Any], file: Path, before: Any) -> tuple[str, str]:
    """What comes of reading, in a process of its own, and the last words."""
    ours, theirs = os.pipe()
    pid = os.fork()
    if pid == 0:
        os.close(ours)
        resource.setrlimit(resource.RLIMIT_CPU, (PATIENCE, PATIENCE))
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
        if os.geteuid() == 0:
            os.setgroups([])
            os.setgid(NOBODY)
            os.setuid(NOBODY)
        sys.stdout = sys.stderr = open(os.devnull, "w")  # noqa: SIM115
        try:
            kind, words = ("unaffected" if read() == before else "D"), ""
        except SAID as error:
            words = f"{type(error).__name__}: {error}"
            kind = "A" if file.name in words or file.parent.name in words else "B"
        except BaseException as error:
            kind, words = "C", f"{type(error).__name__}: {error}"
        os.write(theirs, json.dumps([kind, words[:300]]).encode())
        os._exit(0)
    os.close(theirs)
    with os.fdopen(ours, "rb") as stream:
        said = stream.read()
    status = os.waitpid(pid, 0)[1]
    kind, words = json.loads(said) if said else ("C", f"the process ended with status {status}")
    return kind, words


def main() -> int:
    """Try the kinds that are named by words of the command line, or all; what others came to stays in the table."""
    stored = json.loads(TABLE.read_text())["kinds"] if TABLE.exists() else {}
    with tempfile.TemporaryDirectory() as place:
        home, spare = Path(place) / "home", Path(place) / "spare"
        home.mkdir()
        listed = [case for case in cases(home) if not sys.argv[1:] or case[0].startswith(tuple(sys.argv[1:]))]
        shutil.copytree(home, spare, symlinks=True)
        for kind in dict.fromkeys(name.partition(":")[0] for name, *_ in listed):
            own = [case for case in listed if case[0].partition(":")[0] == kind]
            before, counted, bad = own[0][3](), Counter[str](), []
            for name, file, damage, read in own:
                damage()
                if os.geteuid() == 0:
                    for path in (Path(place), home, *home.rglob("*")):
                        os.chown(path, NOBODY, NOBODY, follow_symlinks=False)
                state, words = outcome(read, file, before)
                counted[state] += 1
                if state in ("B", "C", "D"):
                    bad.append(f"{state} {name}: {words}")
                    print(bad[-1], flush=True)
                shutil.rmtree(home)
                shutil.copytree(spare, home, symlinks=True)
            stored[kind] = {**counted, "listed": bad}
            print(kind, dict(counted), flush=True)
            total = {state: sum(each.get(state, 0) for each in stored.values()) for state in STATES}
            summary = {"corruptions": sum(total.values()), **total, "kinds": stored}
            TABLE.write_text(json.dumps(summary, indent=1) + "\n")
    print(total)
    return int(total["D"] > 0 or total["C"] > 10)


if __name__ == "__main__":
    sys.exit(main())
