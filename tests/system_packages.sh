#!/bin/sh
# System packages for the tests besides Python: a browser for the teach pendant, and a compiler for message packages of
# ROS 2. As root on Debian or Ubuntu, this installs them; elsewhere it prints the missing ones, and their tests are
# skipped.
set -eu

missing=""
need() { # package, commands: any of them shows that it is installed
    package=$1
    shift
    for command in "$@"; do
        if command -v "$command" >/dev/null; then return; fi
    done
    missing="$missing $package"
}
need chromium chromium chromium-browser google-chrome
need g++ g++

if [ -z "$missing" ]; then exit 0; fi
if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
    echo "installing for the tests:$missing"
    export DEBIAN_FRONTEND=noninteractive
    # shellcheck disable=SC2086 # a list of packages
    apt-get update -qq && apt-get install -y -qq --no-install-recommends $missing >/dev/null && exit 0
fi
echo "missing, so some tests are skipped:$missing (Debian: apt install$missing)" >&2
