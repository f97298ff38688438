"""What a user has of the SUMO under an environment: its options, the command of ``sumo``, exported files."""

import copy
import shlex
import tempfile
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path

import gymnasium as gym

from sumo_env.config import ConfigError, warn_once
from sumo_env.env.episode import Episode
from sumo_env.simulator import Simulator, SimulatorError
from sumo_env.sumo import export
from sumo_env.sumo.paths import is_output, listed, temporary_folder, written
from sumo_env.sumo.process import SumoProcess
from sumo_env.sumo.settings import file_settings
from sumo_env.sumo.user_options import OUTPUT_DIR, check_live, check_options, check_outputs
from sumo_env.tasks.base import Task
from sumo_env.traffic.scenario import Scenario


class SumoAccess:
    """The simulator of an environment: SUMO, as its user wants it, or one that was given."""

    def __init__(
        self,
        task: Task,
        simulator: Simulator | None,
        options: Sequence[str],
        live: str | None,
        output_dir: str | Path | None,
    ) -> None:
        if simulator is not None and (options or live or output_dir):
            raise ValueError("sumo_options, live and output_dir are for SUMO: leave out `simulator`")
        self.given = self.simulator = simulator  # the simulator is None where SUMO is not open
        self._live = check_live(live)
        self._options = check_options(options, task.of_files)
        outputs = written(self._options)
        if output_dir is not None:
            if not (task.of_files or outputs):
                raise ConfigError(
                    "output_dir would stay empty: name files that SUMO writes, such as sumo_options="
                    "['--tripinfo-output', 'trips.xml']"
                )
            check_outputs(task.outputs)
            folder = str(Path(output_dir).resolve())
            self._options = {**dict(task.outputs), **self._options, OUTPUT_DIR: folder}
        elif task.outputs:
            names = ", ".join(name for name, _ in task.outputs)
            gym.logger.warn("%s", f"{task.net}: outputs are off ({names}); output_dir=... writes them")
        self._overwritten = ", ".join(f"--{name}" for name in outputs) if output_dir is None else ""
        self._opened = 0

    @property
    def is_sumo(self) -> bool:
        """Whether SUMO drives."""
        return self.given is None or isinstance(self.given, SumoProcess)

    def refuse_backwards(self, what: str, speed: float) -> None:
        """An error if SUMO would have to drive at a negative speed [m/s]."""
        if self.is_sumo and speed < 0.0:
            raise ConfigError(f"{what}, {speed:g} m/s: SUMO's vehicles never drive backwards; replica/* do")

    def open(self) -> Simulator:
        """The simulator for the next episode."""
        self._opened += 1
        if self._opened > 1 and self._overwritten:
            warn_once(
                f"the file of {self._overwritten} has the last episode alone; output_dir=... keeps a file of each one"
            )
        if self.simulator is None:
            self.simulator = SumoProcess(options=self._options, here=True, live=self._live)
        return self.simulator

    def close(self) -> None:
        """Close the simulator."""
        if self.simulator is not None:
            self.simulator.close()
            self.simulator = self.given

    def export(self, folder: Path, episode: Episode) -> list[Path]:
        """See `DrivingEnv.export`."""
        with tempfile.TemporaryDirectory(prefix="sumo_env-", dir=temporary_folder()) as temporary:
            recorded = None
            try:
                simulator: Simulator = copy.deepcopy(self.given) or SumoProcess()
            except (TypeError, SimulatorError):  # it cannot be copied, or has died
                simulator = SumoProcess()
            if episode.scenario.traffic is not None:
                recorded = Path(temporary) / "fcd.xml"
                acting = {name: value for name, value in self._options.items() if not is_output(name)}
                acting.pop(OUTPUT_DIR, None)
                simulator = SumoProcess(options={**acting, "fcd-output": str(recorded)})
            with closing(simulator):
                scenes = [simulator.reset(episode.scenario)]
                for commands in episode.commands:
                    scenes += simulator.step(commands, trace=True).trace
            return export.write(folder, episode.scenario, scenes, recorded)

    def command(self, scenario: Scenario) -> str:
        """See `DrivingEnv.sumo_command`."""
        settings = file_settings(scenario, self._options)
        options = dict(settings.options)
        if settings.elements:  # drawn traffic, in a file that is left to the user
            with tempfile.NamedTemporaryFile("w", suffix=".add.xml", delete=False) as written:
                written.write(settings.elements)
            options["additional-files"] = listed(written.name, options.get("additional-files"))
        return shlex.join(["sumo", *(f"--{name}={value}" for name, value in options.items())])
