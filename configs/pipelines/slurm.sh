#!/bin/bash
#SBATCH --cpus-per-task=4
#SBATCH --mem-per-cpu=1G
#SBATCH --time=01:00:00
# A table learned on a Slurm cluster from many times the frames of scenes.toml. Run it in the folder of the recipes, which must be
# visible on all nodes, with l3 on their PATH:
#   ./slurm.sh 16                submit everything: arrays of 16 tasks simulate, then learn; each step waits for the one before
#   tail -n 3 slurm/16/log/*     show progress
# Existing outputs are not made again, so after a failure run the same call again; after a change of a recipe remove slurm/16 first.
# The table has the same bytes as from one l3 train over all training sets. sbatch takes options from its SBATCH_ variables; the
# Makefile makes the camera, by CAMERA and MEASUREMENTS of the environment.
set -euo pipefail

step=${1:?"number of tasks, such as: ./slurm.sh 16"}
tasks=${2:-$step}
[[ $tasks =~ ^[1-9][0-9]*$ ]] || { echo "slurm.sh: $tasks is no number of tasks" >&2; exit 2; }
folder=slurm/$tasks
shard=$(printf %04d "${SLURM_ARRAY_TASK_ID:-0}")
jobs=${SLURM_CPUS_PER_TASK:-1}
camera=${CAMERA:-camera.h5}
last_pass=second
if grep -Eq '^ *\[\[ *layer *\]\]' classes.toml; then last_pass=third; fi

submit() { # STEP OPTIONS…: submit a step that waits for all tasks of the step before
  last=$(sbatch --parsable --job-name="l3-$1" --output="$folder/log/%x-%A-%a.txt" --kill-on-invalid-dep=yes \
    ${last:+--dependency="afterok:${last%%;*}"} "${@:2}" slurm.sh "$1" "$tasks")
  echo "$1: job ${last%%;*}"
}

make_of() { # OUTPUT COMMAND…: run the command unless the output exists
  [[ -e $1 ]] || "${@:2}" -o "$1"
}

learn() { # PASS OPTIONS…: the partial sums of this task's share
  make_of "$folder/$1_$shard.h5" l3 train "$folder"/training_*.h5 --classes classes.toml \
    --shard "$SLURM_ARRAY_TASK_ID/$tasks" --jobs "$jobs" "${@:2}"
}

case $step in
  camera) make "$camera" unseen.h5 JOBS="$jobs" ;;
  # Every task draws different scenes: its number is the seed.
  simulate)
    make_of "$folder/training_$shard.h5" l3 simulate scenes.toml --camera "$camera" --seed "$SLURM_ARRAY_TASK_ID" \
      --resume --jobs "$jobs"
    ;;
  # Errors of the first pass weigh the rows of the second. With first_draws = 0 in classes.toml there is only one pass: remove
  # "first" and "merge", and "--first" with its file.
  first) learn first ;;
  merge) make_of "$folder/first.h5" l3 train --merge "$folder"/first_*.h5 ;;
  second) learn second --first "$folder/first.h5" ;;
  # A second layer, if classes.toml asks for one, is learned in a third pass, on the table that the others make.
  layer) make_of "$folder/one_layer.h5" l3 train --merge "$folder"/second_*.h5 ;;
  third) learn third --first "$folder/one_layer.h5" ;;
  finish)
    make_of "$folder/table.h5" l3 train --merge "$folder/${last_pass}"_*.h5
    make_of "$folder/picture.png" l3 render "$folder/table.h5" unseen/00000_*_raw.tif
    shown=("$folder/table.h5" unseen.h5)
    [[ $camera == *.h5 ]] && shown+=("$camera")
    make_of "$folder/report.html" l3 report "${shown[@]}"
    l3 evaluate "$folder/table.h5" unseen.h5
    ;;
  "$tasks")
    mkdir -p "$folder/log"
    submit camera
    submit simulate --array="1-$tasks"
    submit first --array="1-$tasks"
    submit merge
    submit second --array="1-$tasks"
    if [[ $last_pass == third ]]; then
      submit layer
      submit third --array="1-$tasks"
    fi
    submit finish
    ;;
  *) echo "slurm.sh: no step $step" >&2; exit 2 ;;
esac
