#!/bin/sh
# An emulator in place of the simulator, with the options of ur_client_library's script of this name.
model=ur5e version=latest address=192.168.56.101 programs='' detached=''
usage() {
    echo "Usage: $(basename "$0") [-m MODEL] [-v VERSION] [-i ADDRESS] [-p PROGRAMS] [-d]"
    echo "  -m  model of the arm (ur5e)     -v  PolyScope version, or latest"
    echo "  -i  address to listen on ($address), which this machine must have"
    echo "  -p  folder of programs          -d  run in the background"
    echo "Without effect: -u (URCaps), -n (container name), -f (port forwarding), -t."
}
while getopts hm:v:p:u:i:f:n:dt option; do
    case $option in
        m) model=$OPTARG ;;
        v) version=$OPTARG ;;
        i) address=$OPTARG ;;
        p) programs=$OPTARG ;;
        d) detached=yes ;;
        u | f | n | t) ;;
        h) usage; exit 0 ;;
        *) usage >&2; exit 2 ;;
    esac
done
set -- --model "$model" --host "$address"
case $model-$version in
    ur3-latest | ur5-latest | ur10-latest) ;;
    *-latest) set -- "$@" --polyscope 5.25.1 ;; # the official driver's tests of the friction model need it
    *) set -- "$@" --polyscope "$version" ;;
esac
[ -z "$programs" ] || set -- "$@" --programs "$programs"
emulator=$(dirname "$0")/ur_emulator
if [ -z "$detached" ]; then
    exec "$emulator" "$@"
fi
ports=$(mktemp) || exit 1
rm "$ports"
nohup "$emulator" "$@" --ports-file "$ports" > /dev/null 2>&1 &
process=$!
until [ -e "$ports" ]; do
    kill -0 $process 2> /dev/null || { "$emulator" "$@" --exit-when-ready; exit 1; }
    sleep 0.1
done
rm "$ports"
echo "The emulator is ready at $address; to stop it: kill $process"
