#!/bin/sh
#SBATCH --job-name=study
#SBATCH --array=1-32
#SBATCH --cpus-per-task=1
#SBATCH --time=02:00:00
#SBATCH --requeue
# A study as an array job of Slurm, a shard for each task, on a folder that all nodes see:
#
#     sbatch --array=1-32 slurm.sh STUDY PROGRAM [ARGUMENT...]
#     merge.sh STUDY.csv STUDY.*.csv          when all tasks are done
#
# for instance: sbatch slurm.sh study build/insilico liver.vtk --patterns gravity,respiration --seeds 200
# Tasks that were killed or ran out of time go on where they were: submit the same line again.
set -eu
study=$1
shift
exec "$@" --study "$study.$SLURM_ARRAY_TASK_ID.csv" --shard "$SLURM_ARRAY_TASK_ID/$SLURM_ARRAY_TASK_COUNT"
