#!/bin/sh
# Wait until the dashboard server of a robot answers; its address is the first argument.
address=${1:-192.168.56.101}
until "$(dirname "$0")/../lib/ur_robot_driver/ur_client" dashboard robotmode --robot-ip "$address" > /dev/null 2>&1; do
    echo "The dashboard server of $address does not answer yet"
    sleep 1
done
echo "The dashboard server of $address answers"
