//! A Slurm of one node, as Debian has it, without systemd: three daemons that this program starts and stops.

use std::fs;
use std::fs::Permissions;
use std::net::TcpListener;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use super::running::{Running, wait_until};
use crate::error::{Error, Naming, Result};
use crate::process::{exit_code, output};

/// How long the daemons have until they answer.
const START: Duration = Duration::from_secs(60);

/// How long jobs have to end that are cancelled.
const CANCEL: Duration = Duration::from_secs(60);

/// Cores of the node, and so tasks at once.
const CORES: usize = 2;

/// The cluster; stopped when dropped.
pub(super) struct Cluster {
    folder: PathBuf,
    node: String,
    /// In the order of their start.
    daemons: Vec<Running>,
}

/// What Slurm knows of a task of an array.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Task {
    /// `PENDING`, `RUNNING`, `COMPLETED`, `FAILED` …
    pub(super) state: String,
    /// The exit code of its last end.
    pub(super) exit_code: u32,
    /// How often it was requeued.
    pub(super) restarts: u32,
}

impl Cluster {
    /// Starts it with its files in an empty folder.
    pub(super) fn start(folder: PathBuf) -> Result<Self> {
        if output(Command::new("id").arg("-u"))?.trim() != "0" {
            return Err(Error::Missing("a Slurm of one's own needs root".to_owned()));
        }
        let node = output(Command::new("hostname").arg("-s"))?.trim().to_owned();
        let mut cluster = Self { folder, node, daemons: Vec::new() };
        cluster.write()?;
        let at = |inside: &str| cluster.folder.join(inside);
        let (conf, key, socket) = (cluster.conf(), at("munge/key"), at("munge/sock"));
        let mut munged = daemon("munged");
        munged.args(["--foreground", "--force", "--num-threads=2"]);
        for (flag, path) in [("key-file", &key), ("socket", &socket)] {
            munged.arg(format!("--{flag}={}", path.display()));
        }
        for name in ["pid", "log", "seed"] {
            munged.arg(format!("--{name}-file={}", at("munge").join(name).display()));
        }
        let logs = ["munged", "slurmctld", "slurmd"].map(|name| at(&format!("log/{name}.talk")));
        cluster.daemons.push(Running::start(&mut munged, &logs[0])?);
        wait_until("munged answers", START, || Ok(socket.exists()))?;
        for (name, log) in ["slurmctld", "slurmd"].into_iter().zip(&logs[1..]) {
            cluster.daemons.push(Running::start(daemon(name).arg("-D").arg("-f").arg(&conf), log)?);
        }
        let is_idle = || Ok(cluster.try_ask("sinfo", &["-h", "-o", "%T"])?.trim() == "idle");
        wait_until("Slurm's node is idle", START, is_idle).map_err(|error| cluster.with_logs(&error))?;
        Ok(cluster)
    }

    fn conf(&self) -> PathBuf {
        self.folder.join("slurm.conf")
    }

    /// Writes the settings and the key of the daemons.
    fn write(&self) -> Result<()> {
        for name in ["munge", "state", "spool", "log"] {
            let path = self.folder.join(name);
            fs::create_dir(&path).of_file(&path)?;
        }
        let (munge, key) = (self.folder.join("munge"), self.folder.join("munge/key"));
        // Programs of all users go through the folder to the socket.
        fs::set_permissions(&munge, Permissions::from_mode(0o711)).of_file(&munge)?;
        let random = Path::new("/dev/urandom");
        let mut bytes = [0; 1024];
        fs::File::open(random).and_then(|mut file| std::io::Read::read_exact(&mut file, &mut bytes)).of_file(random)?;
        fs::write(&key, bytes).of_file(&key)?;
        fs::set_permissions(&key, Permissions::from_mode(0o600)).of_file(&key)?;
        let settings = settings(&self.folder, &self.node, &[free_port()?, free_port()?]);
        let conf = self.conf();
        fs::write(&conf, settings).of_file(&conf)
    }

    /// An error, with the last lines of the daemons' logs.
    fn with_logs(&self, error: &Error) -> Error {
        let mut text = error.to_string();
        for name in ["slurmctld", "slurmd"] {
            let log = fs::read_to_string(self.folder.join("log").join(name)).unwrap_or_default();
            let lines: Vec<&str> = log.lines().collect();
            text += &format!("\n{name}:\n{}", lines[lines.len().saturating_sub(10)..].join("\n"));
        }
        Error::Broken(text)
    }

    /// Lets a program find the cluster.
    pub(super) fn show<'a>(&self, command: &'a mut Command) -> &'a mut Command {
        command.env("SLURM_CONF", self.conf())
    }

    /// What one of Slurm's programs, which must succeed, prints.
    pub(super) fn ask(&self, program: &str, args: &[&str]) -> Result<String> {
        output(self.show(Command::new(program).args(args)))
    }

    /// The same; nothing where it fails.
    fn try_ask(&self, program: &str, args: &[&str]) -> Result<String> {
        let out = self.show(Command::new(program).args(args)).output().of_program(program)?;
        Ok(if out.status.success() { String::from_utf8_lossy(&out.stdout).into_owned() } else { String::new() })
    }

    /// All tasks of an array, or the one job.
    pub(super) fn tasks(&self, job: &str) -> Result<Vec<Task>> {
        let printed = self.ask("scontrol", &["show", "job", "-o", job])?;
        Ok(printed.lines().filter_map(task).collect())
    }

    /// Waits until no task of a job is pending or runs; what Slurm then knows of them.
    pub(super) fn ended(&self, job: &str, limit: Duration) -> Result<Vec<Task>> {
        let is_over = |task: &Task| !["PENDING", "RUNNING", "COMPLETING"].contains(&task.state.as_str());
        wait_until(&format!("job {job} ends"), limit, || {
            std::thread::sleep(Duration::from_millis(200));
            Ok(self.tasks(job)?.iter().all(is_over))
        })
        .map_err(|error| self.with_logs(&error))?;
        self.tasks(job)
    }

    /// Whether the controller's log holds this.
    pub(super) fn logged(&self, text: &str) -> Result<bool> {
        let path = self.folder.join("log/slurmctld");
        Ok(fs::read_to_string(&path).of_file(&path)?.contains(text))
    }

    /// The node's name.
    pub(super) fn node(&self) -> &str {
        &self.node
    }

    /// What the node does: `idle`, `mixed`, `draining`, `drained` …
    pub(super) fn state(&self) -> Result<String> {
        Ok(self.ask("sinfo", &["-h", "-o", "%T"])?.trim().to_owned())
    }

    /// Ends jobs that are still there: their steps would outlive the daemons.
    fn cancel(&self) -> Result<()> {
        exit_code(self.show(Command::new("scancel").args(["--user", "root"])))?;
        wait_until("all jobs are cancelled", CANCEL, || Ok(self.try_ask("squeue", &["-h"])?.trim().is_empty()))
    }
}

impl Drop for Cluster {
    fn drop(&mut self) {
        if self.daemons.len() == 3 && self.cancel().is_err() {
            crate::workspace::say("a job of Slurm may be left");
        }
        // Last to first: the node's daemon, the controller, and munge, through which they talk.
        while let Some(daemon) = self.daemons.pop() {
            drop(daemon);
        }
    }
}

/// A daemon that is stopped by the system where this program is killed.
fn daemon(name: &str) -> Command {
    let mut command = Command::new("setpriv");
    command.args(["--pdeathsig", "TERM", name]);
    command
}

/// The smallest settings that work.
fn settings(folder: &Path, node: &str, ports: &[u16; 2]) -> String {
    let (folder, [controller, daemon]) = (folder.display(), ports);
    let cores = std::thread::available_parallelism().map_or(1, |cores| cores.get().min(CORES));
    format!(
        "ClusterName=guard4d
SlurmctldHost={node}(127.0.0.1)
SlurmUser=root
SlurmdUser=root
AuthType=auth/munge
AuthInfo=socket={folder}/munge/sock
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd.pid
SlurmctldLogFile={folder}/log/slurmctld
SlurmdLogFile={folder}/log/slurmd
SlurmctldPort={controller}
SlurmdPort={daemon}
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
MpiDefault=none
JobAcctGatherType=jobacct_gather/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
SchedulerType=sched/builtin
SchedulerParameters=batch_sched_delay=0,sched_interval=1
ReturnToService=2
KillWait=5
RequeueExit=75
NodeName={node} NodeAddr=127.0.0.1 CPUs={cores} RealMemory=1000 State=UNKNOWN
PartitionName=all Nodes=ALL Default=YES MaxTime=60 State=UP
"
    )
}

/// A port that nobody listens on.
fn free_port() -> Result<u16> {
    TcpListener::bind("127.0.0.1:0").and_then(|listener| listener.local_addr()).map(|at| at.port()).of_program("a port")
}

/// A task as a line of `scontrol show job -o` tells it.
fn task(line: &str) -> Option<Task> {
    let field = |name: &str| line.split(' ').find_map(|word| word.strip_prefix(name)?.strip_prefix('='));
    Some(Task {
        state: field("JobState")?.to_owned(),
        exit_code: field("ExitCode")?.split(':').next()?.parse().ok()?,
        restarts: field("Restarts")?.parse().ok()?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tasks_are_read_as_slurm_tells_them() {
        let line = "JobId=3 ArrayJobId=2 ArrayTaskId=1 JobName=guard4d-farm JobState=FAILED Reason=NonZeroExitCode \
                    Requeue=1 Restarts=2 BatchFlag=1 Reboot=0 ExitCode=3:0 RunTime=00:00:01";
        assert_eq!(task(line), Some(Task { state: "FAILED".to_owned(), exit_code: 3, restarts: 2 }));
        assert_eq!(task(""), None);
    }
}
