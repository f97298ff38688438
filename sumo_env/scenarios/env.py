"""`SumoDrivingEnv`: one learning car in any SUMO scenario."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from sumo_env.config import ConfigError
from sumo_env.env.driving import DrivingEnv
from sumo_env.scenarios.network import NetworkTask

# route files, or routes
Routes = str | Path | Sequence[str | Path] | Mapping[str, Sequence[str]] | Sequence[Sequence[str]]


class SumoDrivingEnv(DrivingEnv):
    """One learning car in any SUMO scenario, with the observations, actions, risk and crashes of the tasks.

        env = SumoDrivingEnv("town.sumocfg", ego_vehicle="taxi7")
        env = SumoDrivingEnv("town.net.xml", "town.rou.xml", ego_route=["in", "main", "out"])

    SUMO drives the files as ``sumo`` does; docs/scenarios.md says how the ego comes and how an episode ends.

    Args:
        network: a configuration (.sumocfg) or a network (.net.xml) of SUMO.
        routes: route files of SUMO, one or several; or routes, each as edges, on which traffic is drawn.
        ego_route: edges that the ego drives along, or several such routes, of which one is drawn.
        config: as of `DrivingEnv`.
        additional: additional files of SUMO, one or several.
        ego_trips: in place of a route, pairs of edges (from, to), of which one is drawn; SUMO finds the route.
        ego_vehicle: in place of a route, the id of a vehicle of the files, which is the ego.
        ego_type: vehicle type of an ego that is added; SUMO's default, else.
        keywords: as of `DrivingEnv`.

    Raises:
        ConfigError: a file that cannot be read, edges that are not connected, an unknown vehicle.
    """

    def __init__(
        self,
        network: str | Path,
        routes: Routes = (),
        ego_route: Sequence[str] | Sequence[Sequence[str]] = (),
        config: Mapping[str, Any] | None = None,
        *,
        additional: str | Path | Sequence[str | Path] = (),
        ego_trips: Sequence[tuple[str, str]] = (),
        ego_vehicle: str = "",
        ego_type: str = "",
        **keywords: Any,
    ) -> None:
        try:
            task = NetworkTask(
                network,
                routes,
                ego_route,
                additional=additional,
                ego_trips=ego_trips,
                ego_vehicle=ego_vehicle,
                ego_type=ego_type,
            )
        except ValueError as error:
            where = "" if str(network) in str(error) else f"{network}: "
            raise ConfigError(f"{where}{error}") from error
        super().__init__(task, config, **keywords)
