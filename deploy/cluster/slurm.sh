#!/usr/bin/env bash
# `elbowroom campaign` as one Slurm job: a scheduler, a worker for each other task, and the campaign itself.
# NOT TESTED: there was no Slurm where it was written. The commands are those of docs/campaigns.md.
#   sbatch deploy/cluster/slurm.sh force_accuracy out/force_accuracy --episodes 10000
# A job that runs out of time loses nothing: submit it again, and it goes on from there.
#SBATCH --job-name=elbowroom
#SBATCH --ntasks=32
#SBATCH --cpus-per-task=1
#SBATCH --mem-per-cpu=1500M
#SBATCH --time=04:00:00
set -euo pipefail

campaign=$1 out=$2
shift 2
# On a file system that all nodes see: the environment, and a certificate with its key
bin=${ELBOWROOM_BIN:-$PWD/.venv/bin} tls=${ELBOWROOM_TLS:-$PWD/tls}
export DASK_DISTRIBUTED__SCHEDULER__WORKER_SATURATION=1.0 DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES=1
export DASK_DISTRIBUTED__COMM__REQUIRE_ENCRYPTION=true WARP_CACHE_PATH=${TMPDIR:-/tmp}/elbowroom-kernels-$SLURM_JOB_ID
files=(--tls-ca-file "$tls/cert.pem" --tls-cert "$tls/cert.pem" --tls-key "$tls/key.pem")
address=tls://$(hostname -f):8786

"$bin/dask" scheduler --protocol tls --port 8786 --no-dashboard "${files[@]}" &
trap 'kill $(jobs -p) 2>/dev/null || true' EXIT
srun --ntasks=$((SLURM_NTASKS - 1)) "$bin/dask" worker "$address" --nthreads 1 --no-dashboard \
  --local-directory "${TMPDIR:-/tmp}" "${files[@]}" &
workers=$!
"$bin/elbowroom" campaign "$campaign" --out "$out" --address "$address" \
  --tls-ca "$tls/cert.pem" --tls-cert "$tls/cert.pem" --tls-key "$tls/key.pem" "$@" &
command=$!
# Without workers the campaign would wait until the job's time is over. When they end first, it stops, and keeps what it has.
ended=0
wait -n "$workers" "$command" || ended=$?
if kill -0 "$command" 2>/dev/null; then
  echo "the workers have ended (exit code $ended); the campaign stops" >&2
  kill -TERM "$command"
  wait "$command" || true
  exit 1
fi
wait "$command"
