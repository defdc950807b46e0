#!/bin/sh
# A sweep as a Slurm array: each task runs its part, as SLURM_ARRAY_TASK_ID and _COUNT say.
#   sbatch --array=1-4 nerf-train/examples/slurm.sh photo.jpg out/sweep
#   nerf-train sweep merge -o out/sweep out/sweep.*            # when all are done
# A task that ended early goes on where it was when the same array is submitted again.
# One that failed is done again the same way, not by its index alone: an array of one task is the whole sweep.
#SBATCH --job-name=nerf-sweep
#SBATCH --cpus-per-task=2
#SBATCH --time=01:00:00
#SBATCH --output=%x-%A_%a.log
set -eu
exec "${NERF_TRAIN:-nerf-train}" --threads "${SLURM_CPUS_PER_TASK:-2}" \
    sweep image "$1" -o "$2.$SLURM_ARRAY_TASK_ID" --rate 1e-3,3e-3,1e-2,3e-2 --steps 200
