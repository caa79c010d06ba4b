#!/bin/sh
# What the tests need of the system beside Python: a browser for those of the teach pendant. As root on Debian or
# Ubuntu it is installed; elsewhere this says what is missing, and those tests are left out.
set -eu
for browser in chromium chromium-browser google-chrome; do
    if command -v "$browser" >/dev/null; then exit 0; fi
done
if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
    echo "installing Chromium for the tests of the teach pendant"
    apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends chromium >/dev/null && exit 0
fi
echo "Chromium is missing: the tests of the teach pendant in a browser are left out. Debian: apt install chromium" >&2
