#!/bin/sh
# A dask scheduler and two workers in three network namespaces, which see each other only through
# a bridge, as machines do through a switch. Needs root.
#
#     benchmarks/two_machines.sh COMMAND...
#
# Runs the command in the scheduler's namespace, with the scheduler's address in SCHEDULER and the
# process ids of the workers in WORKERS, and ends everything.
set -eu
[ $# -gt 0 ] || { echo "usage: $0 COMMAND..." >&2; exit 2; }
python=${PYTHON:-.venv/bin/python}
export PATH="$PATH:/usr/sbin:/sbin" SCHEDULER=tcp://10.77.0.1:8786 OMP_NUM_THREADS=1
name=dask$$
processes=
end() {
    # shellcheck disable=SC2086
    kill -KILL $processes 2> /dev/null || true  # dask may wait for peers that are gone
    wait
    for i in 1 2 3; do ip netns del $name-$i 2> /dev/null || true; done
    ip link del $name 2> /dev/null || true
}
trap end EXIT

ip link add name $name type bridge || { echo "no network namespaces here: root is needed" >&2; exit 3; }
ip link set $name up
for i in 1 2 3; do
    ip netns add $name-$i
    ip link add $name-$i type veth peer name eth0 netns $name-$i
    ip link set $name-$i master $name up
    ip netns exec $name-$i ip link set lo up
    ip netns exec $name-$i ip addr add 10.77.0.$i/24 dev eth0
    ip netns exec $name-$i ip link set eth0 up
done
ip netns exec $name-1 "$python" -m distributed.cli.dask_scheduler --host 10.77.0.1 --port 8786 \
    --no-dashboard 2> /dev/null &
processes=$!
WORKERS=
for i in 2 3; do
    ip netns exec $name-$i "$python" -m distributed.cli.dask_worker $SCHEDULER --host 10.77.0.$i \
        --nthreads 1 --no-nanny --no-dashboard 2> /dev/null &
    processes="$processes $!"
    WORKERS="$WORKERS $!"
done
export WORKERS
ip netns exec $name-1 "$@"
