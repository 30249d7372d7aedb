"""The command that compares on all scenes of a job file, and what comparisons print."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.table import Table

from .console import console, progress_bar
from .methods import InputError
from .serving import CaFile, Cert, Insecure, Key, reach

if TYPE_CHECKING:
    from .experiment import Outcome
    from .jobs import Job


def batch(
    context: typer.Context,
    file: Annotated[Path, typer.Argument(metavar="JOBS.toml")],
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Tell what is left to do; render nothing.")
    ] = False,
    workers: Annotated[
        int, typer.Option(metavar="N", help="Renders at a time, where none is timed.")
    ] = 1,
    scheduler: Annotated[
        str, typer.Option(metavar="tcp://HOST:8786", help="Have a cluster's workers render.")
    ] = "",
    tls_ca_file: CaFile = None,
    tls_cert: Cert = None,
    tls_key: Key = None,
    insecure: Insecure = False,
    flamenco: Annotated[
        str, typer.Option(metavar="http://HOST:8080", help="Have Flamenco's Workers render.")
    ] = "",
    worker_tag: Annotated[
        str, typer.Option(metavar="NAME", help="Of --flamenco: Workers with this tag alone.")
    ] = "",
    unit: Annotated[
        str | None, typer.Option(metavar="KEY", help="Render one image, as Flamenco's Workers do.")
    ] = None,
) -> None:
    """Compare on all scenes that a job file names.

    out, methods, seconds or samples, seeds, resolution, bounces, threads, strict, probe and a table
    \\[tree] are as for compare; reference_samples may be given for reference_seconds. Then come
    the scenes: files with their cameras and frames, or what `lighttree scene` generates.

        methods = ["lighttree", "cycles"]
        seconds = [1, 4]
        [[scene]]
        files = ["shots/*.blend"]
        frames = [1, 10]
        [[scene]]
        generate = "city-small"
        lights = 2000
        cameras = ["street", "roof"]

    The same command again goes on where it was stopped and renders nothing twice.

    With --scheduler the workers of a cluster render, each timed image alone on its machine, and all
    renders of a scene by one kind of CPU; scenes are read from a folder that all machines share, or
    sent. See `lighttree scheduler` and `lighttree worker`.

    With --flamenco a job is submitted that has a task for each image still to do, and a last one
    that runs this command. Job file and scenes must be in storage that all Workers share.
    """
    from .jobs import read_job

    if bool(scheduler) + bool(flamenco) + (unit is not None) > 1:
        raise InputError("--scheduler, --flamenco and --unit exclude each other; give one of them.")
    if (scheduler or flamenco) and workers != 1:
        raise InputError("--workers is for this machine alone; leave it out where others render.")
    if not scheduler and (tls_ca_file or tls_cert or tls_key or insecure):
        raise InputError("Certificates and --insecure are for --scheduler; give that too.")
    if worker_tag and not flamenco:
        raise InputError("--worker-tag is for --flamenco; give that too.")
    try:
        job = read_job(file, workers)
        if dry_run:
            from .forecast import forecast

            table, notes = forecast(job)
            Console(width=max(console.width, 100)).print(table)
            for note in notes:
                typer.echo(note)
            return
        if unit is not None:
            return _render_unit(job, unit)
        if flamenco:
            return _submit(job, file, flamenco, worker_tag)
        from .experiment import run_batch

        cluster = None
        if scheduler:
            security, address, _ = reach(scheduler, tls_ca_file, tls_cert, tls_key, insecure)
            from .cluster import ClusterCrew

            cluster = ClusterCrew(address, security, job.options.num_threads, console.print)
        with progress_bar() as progress:
            outcome = run_batch(
                job.sources, job.out, job.options, progress, command_line(context), cluster
            )
    except InputError as error:
        if not str(error).startswith(f"{file}:"):
            raise
        console.print(str(error), markup=False)  # each line names its place in the file
        raise typer.Exit(2) from error
    tell_outcome(outcome)


def _render_unit(job: Job, key: str) -> None:
    from .one_unit import render_unit

    with progress_bar() as progress:
        path, is_new = render_unit(job, key, progress)
    console.print("Rendered 1 image." if is_new else "Its image is there already.")
    typer.echo(path)


def _submit(job: Job, file: Path, manager: str, tag: str) -> None:
    from .farm import submit

    with progress_bar() as progress:
        submission = submit(job, file, manager, tag, progress)
    for sentence in submission.failed:
        console.print(f"Failed: {sentence}", markup=False)
    if submission.num_units:
        console.print(f"Submitted {submission.num_units} images.")
        typer.echo(submission.page)
    else:
        console.print(
            f"Nothing is left to render; `lighttree batch {file}` writes the report.", markup=False
        )
    if submission.failed:
        raise typer.Exit(1)


def command_line(context: typer.Context) -> str:
    """What was typed."""
    return shlex.join(["lighttree", *context.obj])


def tell_outcome(outcome: Outcome, tables: Sequence[Table] = ()) -> None:
    """Print what a comparison came to; ends with exit code 1 if something failed."""
    kept = f", kept {outcome.num_kept}" if outcome.num_kept else ""
    console.print(f"Rendered {outcome.num_rendered} images{kept}.")
    for sentence in outcome.failed:
        console.print(f"Failed: {sentence}", markup=False)
    for table in tables:
        Console(width=max(console.width, 120)).print(table)
    typer.echo(outcome.report)
    if outcome.failed:
        raise typer.Exit(1)
