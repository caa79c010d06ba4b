#!/bin/sh
# The packages of constraints.txt, each file checked against its hash, then this project without anything else. An index
# that serves other files, or lacks some, is said loudly; the tests then run with the newest packages it has.
set -eu
python=$1

if "$python" -m pip install --quiet --require-hashes --requirement constraints.txt; then
    "$python" -m pip install --quiet --no-deps --no-build-isolation --editable .
else
    echo "****************************************************************************************************" >&2
    echo "NOT REPRODUCIBLE: pip cannot install constraints.txt from the index it uses; the lines above say why." >&2
    echo "The newest packages are installed instead. \`make constraints\` renews the file." >&2
    echo "****************************************************************************************************" >&2
    "$python" -m pip install --quiet --editable '.[test,check]'
fi
