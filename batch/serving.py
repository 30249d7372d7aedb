"""The commands `lighttree scheduler` and `worker`, a cluster's two parts, and who may reach them.

Whoever can reach a part of a cluster can run code there, so beyond one machine everybody needs
certificates. The parts are those of dask.distributed; its own `dask scheduler` and `dask worker
--nthreads 1` serve as well.
"""

from __future__ import annotations

import asyncio
import ipaddress
import logging
from collections.abc import Awaitable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated
from urllib.parse import urlsplit

import typer

from .console import console
from .methods import InputError

if TYPE_CHECKING:
    from distributed import Security

LOOPBACK = "127.0.0.1"
# Their pages of graphs and logs are for this machine alone.
DASHBOARD = f"{LOOPBACK}:0"

CaFile = Annotated[
    Path | None,
    typer.Option("--tls-ca-file", metavar="CA.pem", help="Who signed all certificates."),
]
Cert = Annotated[
    Path | None, typer.Option("--tls-cert", metavar="CERT.pem", help="The certificate of this end.")
]
Key = Annotated[
    Path | None, typer.Option("--tls-key", metavar="KEY.pem", help="And its private key.")
]
Insecure = Annotated[
    bool,
    typer.Option(
        "--insecure",
        help="Without certificates beyond this machine: whoever reaches it can run code.",
    ),
]


def scheduler(
    host: Annotated[str, typer.Option(help="The address to listen at.")] = LOOPBACK,
    port: Annotated[int, typer.Option(min=0, max=65535, help="0 for any that is free.")] = 8786,
    tls_ca_file: CaFile = None,
    tls_cert: Cert = None,
    tls_key: Key = None,
    insecure: Insecure = False,
) -> None:
    """Bring workers and batches together: the middle of a cluster, which renders nothing itself.

        lighttree scheduler --host 10.0.0.1 --tls-ca-file ca.pem --tls-cert me.pem --tls-key me.key

    Beyond this machine it needs certificates, as whoever reaches it can run code; those of dask's
    own configuration count as well.
    """
    security = secure(host, tls_ca_file, tls_cert, tls_key, insecure)
    from distributed import Scheduler

    async def serve() -> None:
        part = Scheduler(
            host=host,
            port=port,
            protocol=scheme(security),
            security=security,
            dashboard_address=DASHBOARD,
        )
        async with part:
            typer.echo(part.address)
            await part.finished()

    _run(serve(), f"{host}:{port}: nothing can listen there")


def worker(
    address: Annotated[str, typer.Argument(metavar="tcp://HOST:8786")],
    tls_ca_file: CaFile = None,
    tls_cert: Cert = None,
    tls_key: Key = None,
    insecure: Insecure = False,
) -> None:
    """Render on this machine for the batches of a scheduler, until stopped.

        lighttree worker tls://10.0.0.1:8786 --tls-ca-file ca.pem --tls-cert me.pem --tls-key me.key

    One is enough on a machine: renders use all cores, or as many threads as the batch says. The
    same LightTree and Blender must be installed as where the batch is started.
    """
    security, address, host = reach(address, tls_ca_file, tls_cert, tls_key, insecure)
    from distributed import Nanny

    async def work() -> None:
        part = Nanny(
            address,
            nthreads=1,
            host=LOOPBACK if is_loopback(host) else None,
            security=security,
            silence_logs=logging.CRITICAL,
            memory_limit=0,  # the renders are in processes of their own
            dashboard_address=DASHBOARD,
        )
        async with part:
            typer.echo(part.worker_address)
            await part.finished()

    console.print(f"Connecting to {address}")
    _run(work(), f"{address}: no scheduler answers there; start it with `lighttree scheduler`")


def _run(part: Awaitable[None], failure: str) -> None:
    """Be a part of a cluster until Ctrl-C; failure: what it means if it does not start."""
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    try:
        asyncio.run(part)
    except KeyboardInterrupt:
        pass
    except RuntimeError as error:  # dask's own word, with the reason behind it
        raise InputError(f"{failure} ({error.__cause__ or error}).") from error


def reach(
    address: str, ca_file: Path | None, cert: Path | None, key: Path | None, insecure: bool
) -> tuple[Security, str, str]:
    """How to reach a scheduler: (security, its address with the scheme that goes with it, host)."""
    url = urlsplit(address if "://" in address else f"tcp://{address}")
    try:
        host, port = url.hostname, url.port
    except ValueError:
        host = port = None
    if not host or not port or url.scheme not in ("tcp", "tls"):
        raise InputError(f"'{address}' is no address of a scheduler; one is tcp://10.0.0.1:8786.")
    security = secure(host, ca_file, cert, key, insecure)
    return security, f"{scheme(security)}://{url.netloc}", host


def secure(
    host: str, ca_file: Path | None, cert: Path | None, key: Path | None, insecure: bool
) -> Security:
    """What connections with a host need; refuses plain ones beyond this machine, unless told."""
    try:
        from distributed import Security
    except ImportError:
        raise InputError(
            "A cluster needs dask.distributed: pip install 'lighttree[cluster]'."
        ) from None
    given = (ca_file, cert, key)
    if any(given):
        if not all(given):
            raise InputError("--tls-ca-file, --tls-cert and --tls-key are given together, or none.")
        if missing := [path for path in given if not path.is_file()]:
            raise InputError(f"{missing[0]}: no such file.")
        names = ("scheduler", "worker", "client")
        files = {f"tls_{name}_cert": str(cert) for name in names}
        files |= {f"tls_{name}_key": str(key) for name in names}
        return Security(require_encryption=True, tls_ca_file=str(ca_file), **files)
    if Security().tls_ca_file:  # of dask's configuration
        return Security(require_encryption=True)
    if not is_loopback(host):
        if not insecure:
            raise InputError(
                f"{host} is beyond this machine, and whoever reaches a cluster can run code on it; "
                "give --tls-ca-file, --tls-cert and --tls-key, or --insecure on a network of yours."
            )
        console.print(f"Without certificates: whoever reaches {host} can run code there.")
    return Security(require_encryption=False)


def scheme(security: Security) -> str:
    return "tls" if security.require_encryption else "tcp"


def is_loopback(host: str) -> bool:
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
