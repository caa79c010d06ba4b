#!/bin/sh
# Installs the packages of constraints.txt, each file checked against its hash, then this project without dependencies.
# If the index serves other files or lacks some, this prints a warning and installs the newest packages it has.
set -eu
python=$1

if "$python" -m pip install --quiet --no-compile --require-hashes --requirement constraints.txt; then
    "$python" -m pip install --quiet --no-compile --no-deps --no-build-isolation --editable .
else
    echo "****************************************************************************************************" >&2
    echo "NOT REPRODUCIBLE: pip cannot install constraints.txt from the index it uses; see the errors above." >&2
    echo "The newest packages are installed instead. \`make constraints\` updates the file." >&2
    echo "****************************************************************************************************" >&2
    "$python" -m pip install --quiet --no-compile --editable '.[test,check]'
fi
