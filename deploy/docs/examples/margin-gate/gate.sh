#!/bin/sh
# Fails with 3 when the law tolerates less delay than it must, or less than in baseline.json.
# After a deliberate change: cp margin/summary.json baseline.json
set -eu
cd "$(dirname "$0")"
exec funnel-hil margin paper_arm --laws my_laws:FilteredTorque --duration 3 --resolution 1 \
  --set plant.physics.engine=mujoco   --at-least 10ms --baseline baseline.json --tolerance 1ms --out margin --overwrite "$@"
