"""What a user has of the SUMO under an environment: libsumo's functions, the command of ``sumo``, exported files."""

from __future__ import annotations

import copy
import shlex
import tempfile
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import ClassVar, Self

import gymnasium as gym

from sumo_env.compat.as_highway_env import ReadAsHighwayEnv
from sumo_env.config import ConfigError
from sumo_env.networks import files
from sumo_env.simulator import Driven, Simulator
from sumo_env.sumo import export
from sumo_env.sumo.process import SumoProcess
from sumo_env.sumo.proxy import Sumo
from sumo_env.sumo.settings import file_settings
from sumo_env.sumo.user_options import OUTPUT_DIR, check_live, check_options
from sumo_env.tasks.network import NetworkTask
from sumo_env.traffic.file_checks import check_outputs
from sumo_env.traffic.scenario import Scenario
from sumo_env.traffic.sumo_files import is_output, temporary_folder


class OwnSumo(ReadAsHighwayEnv):
    """The part of `DrivingEnv` that starts its SUMO and hands it out."""

    _given: Simulator | None
    _simulator: Simulator | None
    _options: dict[str, str]
    _commands: Driven
    _handed_over = False
    _leader: Self | None = None  # of a further learning car: the first one's, with the scenario of all
    steers: ClassVar[bool] = False  # whether the simulator can obey a `SteeringCommand`

    def _prepare_sumo(
        self,
        simulator: Simulator | None,
        options: Sequence[str],
        live: str | None,
        output_dir: str | Path | None,
    ) -> None:
        """Take over what a user says about SUMO, see `DrivingEnv`."""
        if simulator is not None and (options or live or output_dir):
            raise ValueError("sumo_options, live and output_dir are for SUMO: leave out `simulator`")
        self._given = self._simulator = simulator
        self._live = check_live(live)
        self._options = check_options(options, isinstance(self.task, NetworkTask))
        if not isinstance(self.task, NetworkTask):
            if output_dir is not None:
                raise ConfigError("output_dir is for networks of your own: take sumo_options")
        elif output_dir is not None:
            check_outputs(self.task.outputs)
            folder = str(Path(output_dir).resolve())
            self._options = {**dict(self.task.outputs), **self._options, OUTPUT_DIR: folder}
        elif self.task.outputs:
            names = ", ".join(name for name, _ in self.task.outputs)
            gym.logger.warn("%s", f"{self.task.net}: outputs are off ({names}); output_dir=... writes them")

    def export(self, folder: str | Path) -> list[Path]:
        """Write the present episode, as far as it was driven, for ``sumo`` and ``sumo-gui``; returns the files.

        ``episode.sumocfg`` shows what happened. The episode is driven a second time, in a simulator of its own, so that
        every simulation step is in the files. Each of several learning cars writes the same; the first one is blue.
        """
        if self.scenario is None or (scenario := (self._leader or self).scenario) is None:
            raise gym.error.ResetNeeded("call reset() before export()")
        with tempfile.TemporaryDirectory(prefix="sumo_env-", dir=temporary_folder()) as temporary:
            recorded = None
            try:
                simulator: Simulator = copy.deepcopy(self._given) or SumoProcess()
            except TypeError:  # it cannot be copied
                simulator = SumoProcess()
            if scenario.traffic is not None:
                recorded = Path(temporary) / "fcd.xml"
                acting = {name: value for name, value in self._options.items() if not is_output(name)}
                acting.pop(OUTPUT_DIR, None)
                simulator = SumoProcess(options={**acting, "fcd-output": str(recorded)})
            with closing(simulator):
                scenes = [simulator.reset(scenario)]
                for commands in self._commands:
                    scenes += simulator.step(commands, trace=True).trace
            return export.write(Path(folder), scenario, scenes, recorded)

    def _go_on(self, change: Callable[[Scenario], Scenario]) -> None:
        """Let what is to come be that of a changed scenario."""
        lead = self._leader or self
        assert self.scenario is not None and lead.scenario is not None and self._simulator is not None
        lead.scenario = change(lead.scenario)
        self.scenario = replace(lead.scenario, ego=self.scenario.ego)
        self._simulator.imagine(lead.scenario)

    def hand_over(self, to_sumo: bool = True) -> None:
        """Let SUMO drive the ego from the next step on, whatever the actions are, or take it back; also in a copy.

        `reset` takes it back. `sumo_env.hand_over.HandOver` does both by a rule.
        """
        if self.steers:
            raise ConfigError("SUMO drives nothing on the replica: hand_over is for environments on SUMO")
        if (self._leader or self).scenario is None:
            raise gym.error.ResetNeeded("call reset() before hand_over(), which lasts until the next one")
        self._handed_over = to_sumo

    @property
    def sumo(self) -> Sumo:
        """SUMO of this very environment, in a worker too: ``env.unwrapped.sumo.vehicle.getFuelConsumption("ego")``.

        All functions of libsumo, but those that load, step or end a simulation.
        """
        simulator = self._simulator
        if self.scenario is None or not isinstance(simulator, SumoProcess):
            raise gym.error.ResetNeeded("call reset() of an environment on SUMO before asking its SUMO")
        return Sumo(simulator.call)

    @property
    def ego_id(self) -> str:
        """Id of the ego in SUMO and in `scene`."""
        return self.scene.ids[0]

    @property
    def sumo_command(self) -> str:
        """The command of ``sumo`` that drives the traffic of this episode, with SUMO's own files."""
        if self.scenario is None or self.scenario.traffic is None:
            raise gym.error.ResetNeeded("call reset() of a SumoDrivingEnv before sumo_command")
        settings = file_settings(self.scenario, self._options)
        options = dict(settings.options)
        if settings.elements:  # drawn traffic, in a file that is left to the user
            with tempfile.NamedTemporaryFile("w", suffix=".add.xml", delete=False) as written:
                written.write(settings.elements)
            options["additional-files"] = ",".join(
                filter(None, (written.name, options.get("additional-files")))
            )
        return shlex.join(["sumo", *(f"--{name}={value}" for name, value in options.items())])

    def _find_route(self) -> None:
        """What is left of the ego's route, as SUMO has it now."""
        assert self.scenario is not None and self.scene.place is not None
        edges = self.scene.place.ahead
        self._route = tuple(node for edge in edges for node in files.lane(edge)[:2])
        last = files.lane(edges[-1])
        if last in self._road.lanes:
            ego = self.scenario.ego._replace(lane=last, destination=last[1])
            self._spec_of = {ego.id: ego}
