#!/usr/bin/env python3
"""`elbowroom campaign` on workers that Slurm starts one by one, as it finds room, by dask-jobqueue (the extra `slurm`).

python deploy/cluster/jobqueue.py --jobs 64 --tls tls force_accuracy --out out/force_accuracy --episodes 20000

The folder `tls` holds cert.pem and key.pem (docs/campaigns.md says how to make them), environment and campaign stand where all
nodes see them. A job that runs out of time loses nothing: the same command goes on. NOT RUN on a Slurm, for there was none
where it was written: with a stand-in for `sbatch` that runs the job on the same machine.
"""

import argparse
import os
import sys
import threading
import time
from pathlib import Path

import dask.config
from dask_jobqueue import SLURMCluster  # pyright: ignore[reportMissingImports]
from distributed.security import Security

from app.__main__ import main

EACH_FOR_ITSELF = {"distributed.scheduler.worker-saturation": 1.0, "distributed.scheduler.allowed-failures": 1}
"""A worker holds one episode at a time, and none is blamed for a neighbour that kills it."""


def run() -> None:
    """Start the scheduler here, ask Slurm for the workers, and play; the workers go when it ends."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--jobs", type=int, required=True, help="workers, each a job of its own with one core")
    parser.add_argument("--tls", type=Path, required=True, help="folder of cert.pem and key.pem")
    parser.add_argument("--memory", default="1500MB", help="of each job")
    parser.add_argument("--walltime", default="04:00:00", help="of each job")
    parser.add_argument("--queue", help="partition")
    parser.add_argument("--show", action="store_true", help="print the job script, and do nothing")
    asked, campaign = parser.parse_known_args()
    cert, key = (str((asked.tls / name).resolve()) for name in ("cert.pem", "key.pem"))
    dask.config.set(EACH_FOR_ITSELF)
    roles = [(role, part) for role in ("scheduler", "worker", "client") for part in ("cert", "key")]
    security = Security(tls_ca_file=cert, require_encryption=True,
                        **{f"tls_{role}_{part}": cert if part == "cert" else key for role, part in roles})
    kernels = "export WARP_CACHE_PATH=${TMPDIR:-/tmp}/elbowroom-kernels-$SLURM_JOB_ID"
    with SLURMCluster(
            cores=1, processes=1, memory=asked.memory, walltime=asked.walltime, queue=asked.queue, python=sys.executable,
            protocol="tls://", security=security, job_name="elbowroom", job_script_prologue=[kernels],
            local_directory=os.environ.get("TMPDIR", "/tmp"), worker_extra_args=["--no-dashboard"],
            scheduler_options={"dashboard": False}) as cluster:
        if asked.show:
            print(cluster.job_script())
            return
        cluster.scale(asked.jobs)
        print(f"waiting for the first of {asked.jobs} jobs", flush=True)
        cluster.wait_for_workers(1)  # the queue may be long
        threading.Thread(target=replaced, args=(cluster, asked.jobs), daemon=True).start()
        tls = ["--tls-ca", cert, "--tls-cert", cert, "--tls-key", key]
        main(["campaign", *campaign, "--address", cluster.scheduler_address, *tls])


def replaced(cluster: SLURMCluster, jobs: int) -> None:
    """Ask for others in the place of those whose time is over, again and again."""
    while True:
        time.sleep(60.0)
        cluster.scale(jobs)


if __name__ == "__main__":
    run()
