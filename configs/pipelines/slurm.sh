#!/bin/bash
#SBATCH --cpus-per-task=4
#SBATCH --mem-per-cpu=1G
#SBATCH --time=01:00:00
# Trains a table on a Slurm cluster, with many times the frames of scenes.toml. Call this script in the folder of the recipes. All nodes
# need access to this folder, and l3 on their PATH.
#   ./slurm.sh 16                submit all steps, as arrays of 16 tasks; each step waits for the previous step
#   tail -n 3 slurm/16/log/*     show progress
# Existing outputs are not made again. After a failure, repeat the call. After a change of a recipe, delete slurm/16 first.
#
# The table has the same bytes as the table from a single call of l3 train with all training sets. It has one set of transforms for all
# illuminants, because shards do not support a set for each illuminant. The line "lights" of classes.toml is therefore ignored. sbatch
# reads options from SBATCH_ variables. The Makefile makes the camera, according to CAMERA and MEASUREMENTS in the environment.
set -euo pipefail

step=${1:?"the number of tasks is missing; call for example ./slurm.sh 16"}
tasks=${2:-$step}
[[ $tasks =~ ^[1-9][0-9]*$ ]] || { echo "slurm.sh: \"$tasks\" is not a valid number of tasks; use a positive integer" >&2; exit 2; }
folder=slurm/$tasks
shard=$(printf %04d "${SLURM_ARRAY_TASK_ID:-0}")
jobs=${SLURM_CPUS_PER_TASK:-1}
camera=${CAMERA:-camera.h5}
# Passes of the training. Each pass reads the table of the previous pass. The errors of the first pass set the weights of the second pass.
# Each [[layer]] in classes.toml is another pass. If first_draws in classes.toml is 0, remove "first" here.
passes=(first second)
layers=$(grep -Ec '^ *\[\[ *layer *\]\]' classes.toml) || true # grep fails if there is no layer
for ((layer = 2; layer <= layers + 1; layer++)); do passes+=("layer$layer"); done
last_pass=${passes[-1]}

submit() { # STEP OPTIONS…: submit a step that waits for all tasks of the previous step
  last=$(sbatch --parsable --job-name="l3-$1" --output="$folder/log/%x-%A-%a.txt" --kill-on-invalid-dep=yes \
    ${last:+--dependency="afterok:${last%%;*}"} "${@:2}" slurm.sh "$1" "$tasks")
  echo "$1: job ${last%%;*}"
}

make_of() { # OUTPUT COMMAND…: run the command unless the output exists
  [[ -e $1 ]] || "${@:2}" -o "$1"
}

learn() { # PASS: compute the partial sums of this shard
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
  # The seed is the number of the task, so that every task has different scenes.
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
    make -n inputs >/dev/null # if make cannot make the inputs, stop before jobs are submitted
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
  *) echo "slurm.sh: unknown step \"$step\"; call for example ./slurm.sh 16" >&2; exit 2 ;;
esac
