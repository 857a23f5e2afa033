#!/bin/sh
# A Slurm of one node on loopback, for trying things out; needs root or the user slurm to run jobs.
#
#     benchmarks/local_slurm.sh COMMAND...
#
# Runs the command with this Slurm and ends it. Everything it writes is in a folder of its own.
set -eu
PATH=$PATH:/usr/sbin:/sbin
for program in slurmctld slurmd munged sinfo; do
    command -v $program > /dev/null || { echo "no Slurm here: $program is missing (Debian: apt install slurm-wlm)" >&2; exit 3; }
done
[ $# -gt 0 ] || { echo "usage: $0 COMMAND..." >&2; exit 2; }

folder=$(mktemp -d /tmp/local_slurm.XXXXXX)
host=$(hostname -s)
mkdir "$folder/state" "$folder/spool"
chmod 755 "$folder"
dd if=/dev/urandom of="$folder/munge.key" bs=128 count=1 2> /dev/null
chmod 400 "$folder/munge.key"
memory=$(slurmd -C | sed -n 's/.*RealMemory=\([0-9]*\).*/\1/p')
cat > "$folder/slurm.conf" << END
ClusterName=local
SlurmctldHost=$host(127.0.0.1)
SlurmctldPort=26817
SlurmdPort=26818
SlurmUser=$(id -un)
SlurmdUser=$(id -un)
AuthType=auth/munge
AuthInfo=socket=$folder/munge.socket
CredType=cred/munge
StateSaveLocation=$folder/state
SlurmdSpoolDir=$folder/spool
SlurmctldPidFile=$folder/slurmctld.pid
SlurmdPidFile=$folder/slurmd.pid
ProctrackType=proctrack/linuxproc
KillWait=2
TaskPlugin=task/none
SwitchType=switch/none
MpiDefault=none
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU
SchedulerParameters=batch_sched_delay=1,sched_interval=2
ReturnToService=2
NodeName=$host NodeAddr=127.0.0.1 CPUs=$(nproc --all) RealMemory=$memory State=UNKNOWN
PartitionName=local Nodes=ALL Default=YES MaxTime=INFINITE State=UP
END
export SLURM_CONF="$folder/slurm.conf"

munged --foreground --key-file "$folder/munge.key" --socket "$folder/munge.socket" \
    --pid-file "$folder/munge.pid" --log-file "$folder/munge.log" --seed-file "$folder/munge.seed" \
    > "$folder/munged.out" 2>&1 &
processes=$!
slurmctld -D > "$folder/slurmctld.log" 2>&1 &
processes="$processes $!"
slurmd -D -N "$host" > "$folder/slurmd.log" 2>&1 &
processes="$processes $!"
end() {
    scancel --user="$(id -un)" 2> /dev/null || true
    for _ in $(seq 40); do
        [ -n "$(squeue --noheader 2> /dev/null)" ] || break
        sleep 0.5
    done
    # shellcheck disable=SC2086
    kill $processes 2> /dev/null || true
    wait
    rm -rf "$folder"
}
trap end EXIT

for _ in $(seq 60); do
    sinfo --noheader --format=%t 2> /dev/null | grep -q idle && break
    sleep 0.5
done
sinfo --noheader --format=%t 2> /dev/null | grep -q idle || {
    echo "Slurm did not start:" >&2
    tail -n 3 "$folder"/*.log "$folder/munged.out" >&2
    exit 3
}
"$@"
