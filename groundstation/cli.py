"""``groundstation``: the command line. One clear line for every error, never a traceback.

Exit codes: 0 done, 1 failed with one line on stderr, 2 wrong usage. Command line >
environment > file > default, for every setting (``groundstation config show``).
"""

from __future__ import annotations

import asyncio
import os
import sys
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from groundstation import __version__
from groundstation.domain.errors import GroundstationError, UsageError

if TYPE_CHECKING:
    from groundstation.config import LoadedConfig

# Every command imports what it needs when it runs: help and errors come at once.

app = typer.Typer(
    help="Ground station that finds buried or lost people by the faint radio of their phones.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
config_app = typer.Typer(help="Settings.", no_args_is_help=True, rich_markup_mode=None)
app.add_typer(config_app, name="config")

ConfigOption = Annotated[
    Path | None,
    typer.Option(
        "--config", metavar="FILE.toml", help="Settings file; 'config show' prints one to start from."
    ),
]
SetOption = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="NAME=VALUE", help="Any setting of 'config show', e.g. server.port=8001."),
]
AreaOption = Annotated[
    Path | None,
    typer.Option(
        "--area",
        metavar="FILE.geojson",
        help="Search area (polygon), last known places (Points with radius_m).",
    ),
]
TerrainOption = Annotated[
    Path | None,
    typer.Option(
        "--terrain",
        metavar="FILE",
        help="Heights of the ground: .hgt, .asc or .tif; without it, level ground.",
    ),
]
FenceOption = Annotated[
    Path | None,
    typer.Option(
        "--fence",
        metavar="FILE.geojson",
        help="Where vehicles may go: without it nothing is commanded.",
    ),
]
HttpOption = Annotated[
    str | None, typer.Option("--http", metavar="HOST:PORT", help="Where the page is; default 127.0.0.1:8000.")
]
DataDirOption = Annotated[
    Path | None,
    typer.Option(
        "--data-dir", metavar="DIR", help="Gets a directory for each run: journal, snapshots, .tlog."
    ),
]
LogJsonOption = Annotated[bool, typer.Option("--log-json", help="Log as JSON lines.")]
QuietOption = Annotated[bool, typer.Option("--quiet", help="Log warnings and errors only.")]


class Format(StrEnum):
    """What a replay writes."""

    JSON = "json"
    GEOJSON = "geojson"
    KML = "kml"
    GPX = "gpx"
    CSV = "csv"


def load(config: Path | None, assignments: list[str] | None, **given: Any) -> LoadedConfig:
    """Settings in force; options that were not given are None and do not count."""
    from groundstation.config import load_config, parse_assignments
    from groundstation.server.serve import parse_http

    values: dict[str, Any] = dict(parse_assignments(assignments or []))
    http = given.pop("http", None)
    if http is not None:
        values["server.host"], values["server.port"] = parse_http(http)
    values |= {name: value for name, value in given.items() if value not in (None, [], ())}
    return load_config(values, os.environ, config)


@app.command()
def serve(
    link: Annotated[
        list[str] | None,
        typer.Option(
            "--link",
            metavar="URL",
            help="Vehicles: udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT, tcpin:HOST:PORT or "
            "serial:/dev/ttyUSB0:57600; may be given several times.",
        ),
    ] = None,
    http: HttpOption = None,
    forward: Annotated[
        list[str] | None,
        typer.Option("--forward", metavar="URL", help="Another ground station; it listens only."),
    ] = None,
    forward_commands: Annotated[
        bool | None,
        typer.Option(
            "--forward-commands", help="Let the stations on --forward command vehicles (shown on the page)."
        ),
    ] = None,
    area: AreaOption = None,
    terrain: TerrainOption = None,
    fence: FenceOption = None,
    data_dir: DataDirOption = None,
    resume: Annotated[
        Path | None,
        typer.Option("--resume", metavar="SESSION_DIR", help="Go on with this session."),
    ] = None,
    new_session: Annotated[
        bool,
        typer.Option("--new-session", help="Begin anew even where the last run was cut short."),
    ] = False,
    config: ConfigOption = None,
    assignments: SetOption = None,
    log_json: LogJsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """The service: radios in, estimates and the map page out.

    A run that was cut short (power, crash) is gone on with by itself, without any grant:

        groundstation serve --link udpin:0.0.0.0:14550 --area area.geojson --fence fence.geojson
    """
    from groundstation.logs import set_up
    from groundstation.service import run_service

    set_up(json=log_json, quiet=quiet)
    loaded = load(
        config,
        assignments,
        http=http,
        links=link,
        forward=forward,
        forward_commands=forward_commands,
        area=area,
        terrain=terrain,
        fence=fence,
        data_dir=data_dir,
    )
    if not loaded.config.links:
        raise UsageError("no --link is given; needed is at least one, e.g. --link udpin:0.0.0.0:14550")
    asyncio.run(run_service(loaded, resume=resume, new_session=new_session))


@app.command()
def demo(
    scenario: Annotated[
        str, typer.Option(metavar="NAME|FILE", help="open-field, rubble, city-block, or a TOML file.")
    ] = "rubble",
    vehicles: Annotated[int, typer.Option(min=1, max=50)] = 5,
    beacons: Annotated[
        int | None, typer.Option(min=1, max=50, help="Default: all of the scenario's.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="The same seed gives the same world.")] = 1,
    speedup: Annotated[float, typer.Option(min=0.1, max=20.0, help="Simulated seconds a second.")] = 1.0,
    http: HttpOption = None,
    headless: Annotated[
        bool,
        typer.Option("--headless", help="Run --duration seconds, print estimates beside the truth, exit."),
    ] = False,
    duration: Annotated[
        float | None,
        typer.Option(min=1.0, metavar="S", help="Seconds; default: until stopped (headless: 60)."),
    ] = None,
    auto_confirm: Annotated[
        bool,
        typer.Option("--auto-confirm", help="Confirm each proposal at once: for the simulation only."),
    ] = False,
    data_dir: DataDirOption = None,
    config: ConfigOption = None,
    assignments: SetOption = None,
    log_json: LogJsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """A simulated swarm, the service and the map page: no hardware, no configuration."""
    from groundstation.demo import DemoOptions, run_demo
    from groundstation.logs import set_up

    set_up(json=log_json, quiet=quiet or headless)
    loaded = load(config, assignments, http=http, data_dir=data_dir)
    options = DemoOptions(
        scenario=scenario,
        vehicles=vehicles,
        beacons=beacons,
        seed=seed,
        speedup=speedup,
        headless=headless,
        duration_s=duration if duration is not None else (60.0 if headless else None),
        auto_confirm=auto_confirm,
        keep_data=data_dir is not None,
    )
    asyncio.run(run_demo(loaded, options))


@app.command()
def replay(
    source: Annotated[Path, typer.Argument(metavar="FILE.tlog|SESSION_DIR")],
    area: AreaOption = None,
    terrain: TerrainOption = None,
    output_format: Annotated[Format, typer.Option("--format", help="Of the estimates.")] = Format.JSON,
    out: Annotated[Path | None, typer.Option(metavar="FILE", help="Default: standard output.")] = None,
    search_maps: Annotated[
        Path | None,
        typer.Option(
            "--search-maps", metavar="DIR", help="Gets a search map of each beacon as ESRI ASCII grids (GIS)."
        ),
    ] = None,
    speed: Annotated[
        float | None,
        typer.Option(min=0.05, max=1000.0, help="Show it on the page this many times as fast as it was."),
    ] = None,
    http: HttpOption = None,
    config: ConfigOption = None,
    assignments: SetOption = None,
    log_json: LogJsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """The same engines over a recording, or a whole session from its journal. Sends nothing.

    Without --area a recording is searched in a disc of 500 m round the first valid vehicle position.
    """
    from groundstation.logs import set_up
    from groundstation.replay_command import run_replay

    set_up(json=log_json, quiet=quiet)
    run_replay(
        source,
        load(config, assignments, http=http, area=area, terrain=terrain),
        settings_given=bool(config or assignments),
        output_format=output_format.value,
        out=out,
        speed=speed,
        search_maps=search_maps,
    )


@app.command()
def train(
    data: Annotated[
        Path,
        typer.Option(
            metavar="FILE.npz", help="What 'sim-sitl dataset' writes, a file like it, or the paper's CSV."
        ),
    ],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Gets model.onnx, its metadata and its card.")],
    seed: Annotated[int, typer.Option(min=0, help="The same seed gives the same model.")] = 0,
    epochs: Annotated[
        int, typer.Option(min=1, help="At most this many; it stops when it learns no more.")
    ] = 40,
    also: Annotated[
        list[Path] | None, typer.Option("--also", metavar="FILE", help="Further data to train on.")
    ] = None,
    start: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="A trained model to go on from; with few measured logs, whose logit may be used "
            "(the shipped one unless told).",
        ),
    ] = None,
    seeds: Annotated[
        int, typer.Option(min=1, help="Train so many times; the card tells of each, the best is kept.")
    ] = 1,
    learning_curve: Annotated[
        bool, typer.Option("--learning-curve", help="Train on parts of the data too; takes longer.")
    ] = False,
    learning_rate: Annotated[
        float,
        typer.Option(min=1e-7, max=1.0, help="Of the first epochs; less to go on from a model."),
    ] = 2e-3,
    evaluate: Annotated[
        list[str] | None,
        typer.Option("--evaluate", metavar="TITLE=FILE", help="Further data that the card gives figures on."),
    ] = None,
    tap_spacing_ns: Annotated[
        float | None,
        typer.Option(
            "--tap-spacing-ns", help="Of files that do not tell theirs (a CSV, say); 1 ns unless told."
        ),
    ] = None,
) -> None:
    """Train and calibrate the line-of-sight classifier; write ONNX and a model card.

    An interrupted training goes on where it was when started again with the same file and options.
    """
    from groundstation.channel.training.progress import ConsoleProgress
    from groundstation.channel.training.run import TrainingOptions
    from groundstation.channel.training.run import train as run_training

    further = [(title, Path(path)) for title, _, path in (item.rpartition("=") for item in evaluate or [])]
    report = run_training(
        data,
        out,
        options=TrainingOptions(
            seed=seed,
            epochs=epochs,
            seeds=seeds,
            start=start,
            learning_curve=learning_curve,
            learning_rate=learning_rate,
        ),
        also=also or [],
        evaluate=further,
        tap_spacing_ns=tap_spacing_ns,
        command=" ".join(
            [
                f"groundstation train --data {data.name}",
                *(f"--also {path.name}" for path in also or []),
                *([f"--start {start.name}"] if start else []),
                f"--out {out.name} --seed {seed} --epochs {epochs}",
                *([f"--seeds {seeds}"] if seeds > 1 else []),
                *(["--learning-curve"] if learning_curve else []),
                *([f"--learning-rate {learning_rate}"] if learning_rate != 2e-3 else []),
                *([f"--tap-spacing-ns {tap_spacing_ns:g}"] if tap_spacing_ns is not None else []),
            ]
        ),
        progress=ConsoleProgress(sys.stderr),
    )
    test = report.test
    if report.method:
        typer.echo(report.method)
    typer.echo(
        f"model {report.version}: {report.parameters} parameters; held out {test.links} links: "
        f"accuracy {test.accuracy:.3f}, AUC {test.auc:.3f}, ECE {test.ece:.3f}; written to {report.out}"
    )


@config_app.command("show")
def config_show(config: ConfigOption = None, assignments: SetOption = None) -> None:
    """All settings as a TOML file, each with where its value comes from, its unit and what it does."""
    typer.echo(load(config, assignments).text(), nl=False)


@app.command()
def version() -> None:
    """The version."""
    typer.echo(f"groundstation {__version__}")


def main() -> None:
    """Entry point: maps errors to exit codes and one line on stderr."""
    try:
        app()
    except ExceptionGroup as group:
        sys.exit(_fail(_first(group)))
    except Exception as error:
        sys.exit(_fail(error))


def _first(group: BaseException) -> BaseException:
    while isinstance(group, BaseExceptionGroup):
        ours = group.subgroup(GroundstationError)
        group = (ours or group).exceptions[0]
    return group


def _fail(error: BaseException) -> int:
    if isinstance(error, GroundstationError):
        print(f"groundstation: {error}", file=sys.stderr)
        return error.exit_code
    if os.environ.get("GS_TRACEBACK"):
        raise error
    print(
        f"groundstation: internal error: {type(error).__name__}: {error} "
        "(a fault of ours: please report it; GS_TRACEBACK=1 shows where)",
        file=sys.stderr,
    )
    return 1


if __name__ == "__main__":
    main()
