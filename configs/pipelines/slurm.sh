#!/bin/bash
#SBATCH --cpus-per-task=4
#SBATCH --mem-per-cpu=1G
#SBATCH --time=01:00:00
# A table learned on a Slurm cluster from many times the frames of scenes.toml. Run it in the folder of the recipes, which must be
# visible on all nodes, with l3 on their PATH:
#   ./slurm.sh 16                submit everything: arrays of 16 tasks simulate, then learn; each step waits for the one before
#   tail -n 3 slurm/16/log/*     show progress
# Existing outputs are not made again, so after a failure run the same call again; after a change of a recipe remove slurm/16 first.
# The table has the same bytes as from one l3 train over all training sets. It has one set of transforms for all lights, since
# shards cannot learn a set for each: the line "lights" of classes.toml is left out. sbatch takes options from its SBATCH_ variables; the
# Makefile makes the camera, by CAMERA and MEASUREMENTS of the environment.
set -euo pipefail

step=${1:?"number of tasks, such as: ./slurm.sh 16"}
tasks=${2:-$step}
[[ $tasks =~ ^[1-9][0-9]*$ ]] || { echo "slurm.sh: $tasks is no number of tasks" >&2; exit 2; }
folder=slurm/$tasks
shard=$(printf %04d "${SLURM_ARRAY_TASK_ID:-0}")
jobs=${SLURM_CPUS_PER_TASK:-1}
camera=${CAMERA:-camera.h5}
# Each pass reads the table of the one before: errors of the first weigh the rows of the second, and every [[layer]] in classes.toml
# is one more pass. With first_draws = 0 in classes.toml there is no first pass: remove "first" here.
passes=(first second)
layers=$(grep -Ec '^ *\[\[ *layer *\]\]' classes.toml) || true # grep fails if there are none
for ((layer = 2; layer <= layers + 1; layer++)); do passes+=("layer$layer"); done
last_pass=${passes[-1]}

submit() { # STEP OPTIONS…: submit a step that waits for all tasks of the step before
  last=$(sbatch --parsable --job-name="l3-$1" --output="$folder/log/%x-%A-%a.txt" --kill-on-invalid-dep=yes \
    ${last:+--dependency="afterok:${last%%;*}"} "${@:2}" slurm.sh "$1" "$tasks")
  echo "$1: job ${last%%;*}"
}

make_of() { # OUTPUT COMMAND…: run the command unless the output exists
  [[ -e $1 ]] || "${@:2}" -o "$1"
}

learn() { # PASS: the partial sums of this task's share
  local pass before=
  for pass in "${passes[@]}"; do
    [[ $pass != "$1" ]] || break
    before=$folder/$pass.h5
  done
  make_of "$folder/$1_$shard.h5" l3 train "$folder"/training_*.h5 --classes "$folder/classes.toml" \
    --shard "$SLURM_ARRAY_TASK_ID/$tasks" --jobs "$jobs" ${before:+--first "$before"}
}

case $step in
  camera) make inputs JOBS="$jobs" ;;
  # Every task draws different scenes: its number is the seed.
  simulate)
    make_of "$folder/training_$shard.h5" l3 simulate scenes.toml --camera "$camera" --seed "$SLURM_ARRAY_TASK_ID" \
      --resume --jobs "$jobs"
    ;;
  first | second | layer[0-9]) learn "$step" ;;
  merge-*) make_of "$folder/${step#merge-}.h5" l3 train --merge "$folder/${step#merge-}"_*.h5 ;;
  finish)
    make_of "$folder/table.h5" l3 train --merge "$folder/${last_pass}"_*.h5
    make_of "$folder/picture.png" l3 render "$folder/table.h5" unseen/00000_*_raw.tif
    shown=("$folder/table.h5" unseen.h5)
    [[ $camera == *.h5 ]] && shown+=("$camera")
    make_of "$folder/report.html" l3 report "${shown[@]}"
    l3 evaluate "$folder/table.h5" unseen.h5
    ;;
  "$tasks")
    make -n inputs >/dev/null # refuses what make cannot do, before anything waits in a queue
    mkdir -p "$folder/log"
    sed '/^lights = /d' classes.toml >"$folder/classes.toml"
    submit camera
    submit simulate --array="1-$tasks"
    for pass in "${passes[@]}"; do
      submit "$pass" --array="1-$tasks"
      [[ $pass == "$last_pass" ]] || submit "merge-$pass"
    done
    submit finish
    ;;
  *) echo "slurm.sh: no step $step" >&2; exit 2 ;;
esac
