//! Several machines: network namespaces, each with its own address, joined by a bridge.

use crate::determinism::{EPISODES, undisturbed};
use crate::skipped;
use herd_tests::hosts::Hosts;
use herd_tests::patience::{LONG, SHORT};
use herd_tests::{Process, Run};

/// A learner on host 0 that the other hosts can reach.
fn learner(run: &Run, hosts: &Hosts) -> Process {
    let listen = format!("{}:0", hosts.address(0));
    let command = run.configured(&["learner", "--listen", &listen, "--insecure"]);
    run.spawn("learner", &mut hosts.on(0, &command))
}

/// An actor on that host.
fn actor(run: &Run, hosts: &Hosts, host: usize, learner: &str) -> Process {
    run.spawn("actor", &mut hosts.on(host, &run.herd(&["actor", "--learner", learner])))
}

#[test]
fn hosts_train_together() {
    let hosts = match Hosts::new(3) {
        Ok(hosts) => hosts,
        Err(why) => return skipped("hosts_train_together", &why),
    };
    let run = Run::new(EPISODES);
    let learner = learner(&run, &hosts);
    let address = run.address();
    assert!(address.starts_with(&hosts.address(0)), "{address}");
    let (one, other) = (actor(&run, &hosts, 1, &address), actor(&run, &hosts, 2, &address));
    learner.wait(LONG).expect(0, &[]);
    one.wait(SHORT).expect(0, &[]);
    other.wait(SHORT).expect(0, &[]);
    assert_eq!(run.fingerprint(), *undisturbed());
}

#[test]
fn a_host_that_loses_its_network_changes_no_bit() {
    let hosts = match Hosts::new(3) {
        Ok(hosts) => hosts,
        Err(why) => return skipped("a_host_that_loses_its_network_changes_no_bit", &why),
    };
    let run = Run::new(EPISODES);
    let learner = learner(&run, &hosts);
    let address = run.address();
    let (one, mut other) = (actor(&run, &hosts, 1, &address), actor(&run, &hosts, 2, &address));
    run.wait_for_commits(4);
    hosts.pull_cable(2);
    run.assert_midway();
    learner.wait(LONG).expect(0, &[]);
    one.wait(SHORT).expect(0, &[]);
    assert_eq!(run.fingerprint(), *undisturbed());
    assert!(other.is_running(), "an actor without a network waits for it: {}", other.stderr());
    hosts.plug_cable(2);
}
