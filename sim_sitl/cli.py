"""``sim-sitl``: the simulated swarm, overlays on recordings, labelled channel data.

Keeps the rule that a user never sees a traceback: one clear line, exit code 1 for failures
and 2 for wrong usage.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from groundstation.domain.errors import GroundstationError, UsageError
from sim_sitl.cir_encoding import CirEncoding
from sim_sitl.endpoints import parse_link
from sim_sitl.lossy_link import LinkQuality
from sim_sitl.modes import Flavour
from sim_sitl.progress import Progress
from sim_sitl.radio_sensor import SensorSettings
from sim_sitl.scenario import write_geojson
from sim_sitl.scenario_file import SHIPPED, load_scenario

app = typer.Typer(
    help="A simulated swarm that hears simulated beacons, over MAVLink.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)

ScenarioOption = Annotated[
    str, typer.Option("--scenario", metavar="NAME|FILE", help=f"{', '.join(SHIPPED)}, or a TOML file.")
]
SeedOption = Annotated[int, typer.Option(min=0, max=2**63 - 1, help="The same seed gives the same run.")]
BeaconsOption = Annotated[
    int | None,
    typer.Option(
        min=1, max=200, help="The scenario's first N beacons, more drawn in its area; default: all it has."
    ),
]
CirOption = Annotated[
    int,
    typer.Option(min=0, help="Send a CIR with each n-th packet of a beacon; 0: only when the station asks."),
]
AnglesOption = Annotated[str, typer.Option(help="Frame of SAR_AOA: body, earth, or off.")]
TunnelOption = Annotated[bool, typer.Option("--tunnel", help="Wrap sensor messages in TUNNEL.")]
LinkStateOption = Annotated[
    bool, typer.Option("--link-state", help="Send SAR_LINK_STATE, as an on-board classifier would.")
]


def _sensor(
    cir_every: int, cir_full: bool, encoding: str, angles: str, link_state: bool, tunnel: bool
) -> SensorSettings:
    if angles not in ("body", "earth", "off"):
        raise UsageError(f"--angles {angles!r}; needed: body, earth or off")
    encodings = {
        "u8-log": CirEncoding.U8_LOG_MAGNITUDE,
        "u16": CirEncoding.U16_MAGNITUDE,
        "i8-iq": CirEncoding.I8_IQ,
    }
    if encoding not in encodings:
        raise UsageError(f"--cir-encoding {encoding!r}; needed: {', '.join(encodings)}")
    return SensorSettings(
        cir_every=cir_every,
        cir_full=cir_full,
        cir_encoding=encodings[encoding],
        angles=angles,
        link_state=link_state,
        tunnel=tunnel,
    )


@app.command()
def swarm(
    link: Annotated[
        str,
        typer.Option(help="The station: udpout:HOST:PORT (a port of its own per vehicle) or tcp:HOST:PORT."),
    ] = "udpout:127.0.0.1:14550",
    vehicles: Annotated[int, typer.Option(min=1, max=200)] = 4,
    beacons: BeaconsOption = None,
    scenario: ScenarioOption = "open-field",
    seed: SeedOption = 1,
    speedup: Annotated[float, typer.Option(min=0.05, max=100.0, help="Simulated seconds a second.")] = 1.0,
    duration: Annotated[
        float | None, typer.Option(min=0.0, help="Simulated seconds; default: until stopped.")
    ] = None,
    airborne: Annotated[
        bool,
        typer.Option(
            "--airborne/--grounded",
            help="Start in the air, flying the first pattern, or booting on the ground.",
        ),
    ] = True,
    autopilot: Annotated[Flavour, typer.Option(help="Whose modes and answers.")] = Flavour.ARDUPILOT,
    ready_after: Annotated[
        float, typer.Option(min=0.0, help="Seconds from boot until a grounded vehicle arms.")
    ] = 42.0,
    truth: Annotated[
        Path | None, typer.Option(help="Write the beacons' true places here at the start (JSON).")
    ] = None,
    attach: Annotated[
        str | None,
        typer.Option(
            metavar="URL", help="Put the sensor on the real autopilots that send to udpin:HOST:PORT."
        ),
    ] = None,
    loss: Annotated[float, typer.Option(min=0.0, max=1.0, help="Share of frames lost, each way.")] = 0.0,
    delay_ms: Annotated[float, typer.Option(min=0.0, max=60_000.0)] = 0.0,
    jitter_ms: Annotated[float, typer.Option(min=0.0, max=60_000.0)] = 0.0,
    duplicate: Annotated[
        float, typer.Option(min=0.0, max=1.0, help="Share of frames that come twice.")
    ] = 0.0,
    corrupt: Annotated[
        float, typer.Option(min=0.0, max=1.0, help="Share of frames with a damaged byte.")
    ] = 0.0,
    cir_every: CirOption = 2,
    cir_full: Annotated[bool, typer.Option("--cir-full", help="Unasked CIRs hold all 1,016 taps.")] = False,
    cir_encoding: Annotated[str, typer.Option(help="u8-log, u16 or i8-iq.")] = "u8-log",
    angles: AnglesOption = "body",
    link_state: LinkStateOption = False,
    tunnel: TunnelOption = False,
    quiet: Annotated[bool, typer.Option("--quiet", help="No progress lines.")] = False,
    end_with_stdin: Annotated[
        bool,
        typer.Option(
            "--end-with-stdin", help="End when standard input closes: for programs that start this one."
        ),
    ] = False,
) -> None:
    """Fly a simulated swarm, or attach the simulated sensor to real autopilots."""
    from sim_sitl.attach import AttachOptions, run_attached
    from sim_sitl.simulation import SimulationSettings
    from sim_sitl.swarm import SwarmOptions, run_swarm

    world = load_scenario(scenario)
    target = parse_link(link, ("udpout", "tcp"))
    sensor = _sensor(cir_every, cir_full, cir_encoding, angles, link_state, tunnel)
    quality = LinkQuality(loss, delay_ms * 1e-3, jitter_ms * 1e-3, duplicate, corrupt)
    report = None if quiet else _line
    if attach is not None:
        listen = parse_link(attach, ("udpin",))
        if speedup != 1.0:
            raise UsageError("--speedup does not go with --attach: real autopilots keep their own time")
        run_attached(
            AttachOptions(world, listen, target, beacons, seed, duration, truth, quality, sensor), report
        )
        return
    settings = SimulationSettings(
        airborne=airborne, flavour=autopilot, ready_after_s=ready_after, sensor=sensor
    )
    if report is not None:
        _line(
            f"{world.name}: {vehicles} vehicles to {link}, seed {seed} "
            "(L line of sight, n obstructed, ? not heard yet)"
        )
    run_swarm(
        SwarmOptions(world, target, vehicles, beacons, seed, speedup, duration, truth, quality, settings),
        report,
        end_with_stdin=end_with_stdin,
    )


@app.command()
def overlay(
    recording: Annotated[Path, typer.Argument(metavar="IN.tlog")],
    out: Annotated[Path, typer.Option(metavar="OUT.tlog", help="The truth goes beside it, as .truth.json.")],
    scenario: ScenarioOption = "open-field",
    seed: SeedOption = 1,
    beacons: BeaconsOption = None,
    cir_every: CirOption = 2,
    angles: AnglesOption = "body",
    link_state: LinkStateOption = False,
    tunnel: TunnelOption = False,
) -> None:
    """Put the simulated sensor on the vehicles of a recording."""
    from sim_sitl.overlay import overlay as run_overlay

    sensor = _sensor(cir_every, False, "u8-log", angles, link_state, tunnel)
    result = run_overlay(recording, load_scenario(scenario), seed, out, sensor, beacons)
    _line(
        f"{out}: {result.records} records of vehicles {', '.join(map(str, result.vehicles))} kept, "
        f"{result.added} sensor frames added; truth: {result.truth}"
    )


@app.command()
def dataset(
    rows: Annotated[int, typer.Option(help="Captures; the paper has 41,000.")],
    out: Annotated[
        Path,
        typer.Option(metavar="FILE", help="By its suffix: .npz (every column) or .csv (the paper's)."),
    ],
    seed: SeedOption = 1,
    randomise: Annotated[
        bool,
        typer.Option("--randomise", help="Vary the sounder by link, as the shipped classifier is trained."),
    ] = False,
    bandwidth_mhz: Annotated[
        float | None, typer.Option(help="Of the plain kind's sounder; 500 unless told, the paper says 3.")
    ] = None,
    tap_spacing_ns: Annotated[
        float | None,
        typer.Option(help="1.0016 unless told; with a bandwidth about two taps to 1/bandwidth."),
    ] = None,
    taps: Annotated[int, typer.Option(help="Taps of the full response.")] = 1016,
    packets: Annotated[int, typer.Option(help="Consecutive captures of one geometry.")] = 4,
    equal_noise: Annotated[
        bool,
        typer.Option("--equal-noise", help="Plain kind: noise does not follow from the link budget."),
    ] = False,
) -> None:
    """Write labelled channel data (a row a capture), LOS and NLOS in equal parts.

    For example: sim-sitl dataset --rows 41000 --seed 1 --out channels.npz
    """
    from sim_sitl.dataset import DatasetOptions, dataset_sounder, write_dataset

    if randomise and (bandwidth_mhz is not None or tap_spacing_ns is not None):
        raise UsageError("--randomise draws the bandwidth and the tap spacing; leave them out")
    options = DatasetOptions(
        dataset_sounder(bandwidth_mhz, tap_spacing_ns, taps), packets, randomise, equal_noise
    )
    progress = Progress("rows")
    try:
        write_dataset(rows, seed, out, progress, options)
    finally:
        progress.end()
    _line(f"{out}: {rows} rows, seed {seed}")


@app.command()
def study(
    name: Annotated[
        str,
        typer.Argument(
            metavar="NAME",
            help="table3 (channel classifiers), table4 (every method in each environment), fig3 … fig10, "
            "hard (where the paper does not look), bandwidth (how much of a channel response to send), "
            "measured (a file of measured logs, beside trees), "
            "tracking (flights, beside the exact Bayes filter), "
            "all (table4, the figures and hard).",
        ),
    ],
    out: Annotated[
        Path,
        typer.Option(
            metavar="DIR",
            help="Gets NAME.md (the report), NAME.csv, NAME-profile.csv and a PNG a section; files of "
            "these names are replaced, others left alone.",
        ),
    ],
    trials: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Of each case (table3, bandwidth: rows of data; tracking: runs, 300 will do); default: "
            "5,000 as the paper, and 10 ways to deal the folds of measured.",
        ),
    ] = None,
    seed: SeedOption = 1,
    jobs: Annotated[
        int | None, typer.Option(min=1, help="Processes on this machine; default: one a core.")
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="URL", help="Work on the Dask cluster of this scheduler: tcp://HOST:8786."),
    ] = None,
    methods: Annotated[
        str | None, typer.Option(metavar="A,B", help="Only these methods of the study, by name.")
    ] = None,
    case: Annotated[
        str | None, typer.Option(metavar="A,B", help="Only these cases (tracking), by name.")
    ] = None,
    data: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Of measured: responses with label and log_id.")
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="No progress lines.")] = False,
) -> None:
    """Make the paper's tables and figures anew: each method beside the paper's figure and the limit.

    The same trials and seed give the same figures, on however many processes or machines.

    For example: sim-sitl study table4 --trials 500 --out table4
    """
    from sim_sitl.studies.commands import ROWS, TRIALS, TRIALS_OF, StudyOptions, run_study

    chosen, cases = (
        tuple(part.strip() for part in (names or "").split(",") if part.strip()) for names in (methods, case)
    )
    progress = Progress("rows" if name in ROWS else "trials")
    trials = TRIALS_OF.get(name, TRIALS) if trials is None else trials
    try:
        files = run_study(
            StudyOptions(name, trials, seed, out, jobs, scheduler, chosen, cases, data),
            None if quiet else progress,
        )
    finally:
        progress.end()
    for path in files:
        _line(str(path))


@app.command("scenario")
def show_scenario(
    name: Annotated[str, typer.Argument(metavar="NAME|FILE")],
    area: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write the search area here (GeoJSON).")
    ] = None,
    fence: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write the fence here (GeoJSON).")
    ] = None,
) -> None:
    """Check a scenario, say what is in it, and write its search area and fence."""
    world = load_scenario(name)
    write_geojson(world, area, fence)
    _line(f"{world.name}: {world.title}")
    _line(
        f"{len(world.beacons)} beacons, {len(world.obstacles)} obstacles, "
        f"{world.propagation.nlos_model} when obstructed"
    )


def _line(text: str) -> None:
    print(text, flush=True)


def main() -> None:
    """The console script."""
    try:
        app()
    except GroundstationError as error:
        sys.stderr.write(f"sim-sitl: {error}\n")
        raise SystemExit(error.exit_code) from None
    except OSError as error:
        sys.stderr.write(f"sim-sitl: {error.filename or ''}: {error.strerror or error}\n")
        raise SystemExit(1) from None


if __name__ == "__main__":
    main()
