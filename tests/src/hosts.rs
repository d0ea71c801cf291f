//! Several machines on one: network namespaces joined by a bridge, removed with their guard.
//!
//! ```text
//! host 0 (10.a.b.1) ── veth ──┐
//! host 1 (10.a.b.2) ── veth ──┤ bridge
//! host 2 (10.a.b.3) ── veth ──┘
//! ```
//! Names and subnet follow from this process's id, so that two test runs on one machine do not meet.

use std::path::Path;
use std::process::Command;
use std::sync::atomic::{AtomicU32, Ordering};

/// Some machines on a network of their own.
#[derive(Debug)]
pub struct Hosts {
    tag: String,
    subnet: String,
    count: usize,
}

impl Hosts {
    /// Makes this many; an error says why this machine cannot.
    pub fn new(count: usize) -> Result<Self, String> {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        if !rustix::process::geteuid().is_root() {
            return Err("network namespaces need root".into());
        }
        let number = std::process::id().wrapping_mul(4) + NUMBER.fetch_add(1, Ordering::Relaxed);
        let tag = format!("{:x}", number & 0xff_ffff);
        let subnet = format!("10.{}.{}", 64 + (number >> 8) % 128, number & 0xff);
        // From here on dropping it removes what was made.
        let hosts = Self { tag, subnet, count };
        hosts.make()?;
        Ok(hosts)
    }

    fn make(&self) -> Result<(), String> {
        let bridge = self.bridge();
        ip(&format!("link add {bridge} type bridge"))?;
        ip(&format!("link set {bridge} up"))?;
        for host in 0..self.count {
            let (name, cable, address) = (self.name(host), self.cable(host), self.address(host));
            ip(&format!("netns add {name}"))?;
            ip(&format!("link add {cable} type veth peer name eth0 netns {name}"))?;
            ip(&format!("link set {cable} master {bridge} up"))?;
            ip(&format!("-n {name} addr add {address}/24 dev eth0"))?;
            ip(&format!("-n {name} link set eth0 up"))?;
            ip(&format!("-n {name} link set lo up"))?;
        }
        Ok(())
    }

    /// The address of a host.
    pub fn address(&self, host: usize) -> String {
        format!("{}.{}", self.subnet, host + 1)
    }

    /// `command`, on that host.
    pub fn on(&self, host: usize, command: &Command) -> Command {
        let mut there = Command::new("nsenter");
        there.arg(format!("--net=/run/netns/{}", self.name(host))).arg("--");
        there.arg(command.get_program()).args(command.get_args());
        if let Some(directory) = command.get_current_dir().map(Path::to_owned) {
            there.current_dir(directory);
        }
        there
    }

    /// Pulls the cable of a host: nothing gets through and nobody is told.
    #[track_caller]
    pub fn pull_cable(&self, host: usize) {
        ip(&format!("link set {} down", self.cable(host))).expect("the cable is there");
    }

    /// Plugs it in again.
    #[track_caller]
    pub fn plug_cable(&self, host: usize) {
        ip(&format!("link set {} up", self.cable(host))).expect("the cable is there");
    }

    fn bridge(&self) -> String {
        format!("hb{}", self.tag)
    }

    fn name(&self, host: usize) -> String {
        format!("herd-{}-{host}", self.tag)
    }

    fn cable(&self, host: usize) -> String {
        format!("hv{}-{host}", self.tag)
    }
}

impl Drop for Hosts {
    fn drop(&mut self) {
        for host in 0..self.count {
            let _ = ip(&format!("netns del {}", self.name(host)));
            // Goes with its namespace, but later than this returns.
            let _ = ip(&format!("link del {}", self.cable(host)));
        }
        let _ = ip(&format!("link del {}", self.bridge()));
    }
}

/// Runs `ip <words>`.
fn ip(words: &str) -> Result<(), String> {
    let output = Command::new("ip").args(words.split(' ')).output().map_err(|error| format!("ip: {error}"))?;
    let said = String::from_utf8_lossy(&output.stderr);
    if output.status.success() { Ok(()) } else { Err(format!("ip {words}: {}", said.trim_end())) }
}
