//! CPU time and memory of processes, from /proc.

use std::path::PathBuf;

/// Clock ticks a second in /proc; Linux shows 100 to everybody, whatever the kernel uses itself.
const TICKS_PER_SEC: f64 = 100.0;

/// CPU time that a process has used, all its threads together, s; 0 for one that is gone.
pub(crate) fn used_secs(pid: u32) -> f64 {
    let read = std::fs::read_to_string(PathBuf::from(format!("/proc/{pid}/stat")));
    read.ok().and_then(|stat| parse_stat(&stat)).unwrap_or(0.0)
}

/// CPU time that all processes of this machine have used, s.
pub(crate) fn machine_secs() -> f64 {
    std::fs::read_to_string("/proc/stat").ok().and_then(|stat| parse_machine(&stat)).unwrap_or(0.0)
}

/// Most memory that a process had at once, bytes; 0 for one that is gone.
pub(crate) fn peak_bytes(pid: u32) -> u64 {
    let read = std::fs::read_to_string(PathBuf::from(format!("/proc/{pid}/status")));
    read.ok().and_then(|status| parse_peak(&status)).unwrap_or(0)
}

fn parse_stat(stat: &str) -> Option<f64> {
    // The name of the program may hold spaces and brackets; the numbers begin after the last one.
    let (_, numbers) = stat.rsplit_once(')')?;
    let mut numbers = numbers.split_whitespace().skip(11);
    let (user, system): (u64, u64) = (numbers.next()?.parse().ok()?, numbers.next()?.parse().ok()?);
    Some((user + system) as f64 / TICKS_PER_SEC)
}

fn parse_machine(stat: &str) -> Option<f64> {
    let numbers = stat.lines().next()?.strip_prefix("cpu ")?;
    let ticks: Vec<u64> = numbers.split_whitespace().map_while(|number| number.parse().ok()).collect();
    // user, nice, system, then idle and waiting for the disk, then interrupts.
    let busy = ticks.iter().take(7).sum::<u64>() - ticks.get(3)? - ticks.get(4)?;
    Some(busy as f64 / TICKS_PER_SEC)
}

fn parse_peak(status: &str) -> Option<u64> {
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    Some(line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()? * 1024)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_kernel_is_understood() {
        let stat = "42 (a) name) S 1 2 3 4 5 6 7 8 9 10 150 50 0 0 20 0 3 0 100";
        assert_eq!(parse_stat(stat), Some(2.0));
        assert_eq!(parse_machine("cpu  100 20 30 999 999 40 10 0 0 0\ncpu0 1"), Some(2.0));
        assert_eq!(parse_peak("Name:\therd\nVmHWM:\t  2048 kB\n"), Some(2 << 20));
        assert!(peak_bytes(std::process::id()) > 1 << 16, "this process has memory");
    }
}
