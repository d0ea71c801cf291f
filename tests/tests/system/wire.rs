//! Whatever an actor sends, the learner takes it or refuses it by name, and others train on.

use herd_proto::PROTOCOL;
use herd_proto::v1::{self, actor_message::Message as Said};
use herd_tests::patience::{LONG, SHORT};
use herd_tests::wire::{Raw, finished, hello, piece};
use herd_tests::{Process, Run};
use tonic::Code;

const EPISODES: u64 = 4;

/// The bytes of some f32.
fn bytes(numbers: &[f32]) -> Vec<u8> {
    numbers.iter().flat_map(|number| number.to_le_bytes()).collect()
}

/// A run whose learner waits for actors.
/// Without evaluations, so that the first lease is an episode.
fn waiting() -> (Run, Process, String) {
    let run = Run::new(EPISODES).with("evaluation.every_episodes=0");
    let learner = run.learner();
    let address = run.address();
    (run, learner, address)
}

/// An honest actor joins and the run completes.
#[track_caller]
fn completes(run: &Run, learner: Process) {
    let actor = run.actor();
    learner.wait(LONG).expect(0, &[]);
    actor.wait(SHORT).expect(0, &[]);
    assert_eq!(run.episodes(), (0..EPISODES).collect::<Vec<_>>());
}

/// Sends what `damaged` makes of a valid piece of a lease; the answer must hold `words`, the run must complete.
async fn refused(damaged: impl FnOnce(&mut v1::Transitions), words: &[&str]) {
    let (run, learner, address) = waiting();
    let mut raw = Raw::join(&address, hello()).await.expect("joins");
    let lease = raw.lease().await;
    let mut message = piece(&lease, 0, 3);
    damaged(&mut message);
    raw.say(Said::Transitions(message)).await;
    let refusal = raw.refusal().await;
    for word in words {
        assert!(refusal.reason.contains(word), "{:?} does not name {word:?}", refusal.reason);
    }
    drop(raw);
    completes(&run, learner);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_number_that_is_none_is_refused() {
    refused(|piece| piece.rewards = bytes(&[0.0, f32::NAN, 0.0]).into(), &["reward", "transition 1", "NaN"]).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_action_outside_the_box_is_refused() {
    refused(|piece| piece.actions = bytes(&[1.5; 12]).into(), &["action[0]", "1.5", "[-1, 1]"]).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_column_of_the_wrong_size_is_refused() {
    refused(|piece| piece.actions.truncate(47), &["actions", "47 bytes", "48"]).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_count_without_columns_is_refused() {
    refused(|piece| piece.count = u32::MAX, &["count", "4294967295", "4096"]).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn another_attempt_is_refused() {
    refused(|piece| piece.attempt += 7, &["holds the lease as attempt"]).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_piece_out_of_order_is_refused() {
    refused(|piece| piece.first = 5, &["start at 5", "expected 0"]).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_episode_that_was_not_leased_is_refused() {
    let unknown = v1::WorkItem { item: Some(v1::work_item::Item::Episode(77)) };
    refused(|piece| piece.work = Some(unknown), &["not leased"]).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_piece_of_nothing_is_refused() {
    refused(|piece| piece.work = None, &["work is missing"]).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_outcome_that_does_not_count_its_transitions_is_refused() {
    let (run, learner, address) = waiting();
    let mut raw = Raw::join(&address, hello()).await.expect("joins");
    let lease = raw.lease().await;
    raw.say(Said::Transitions(piece(&lease, 0, 3))).await;
    raw.say(Said::Finished(finished(&lease, 4))).await;
    let reason = raw.refusal().await.reason;
    assert!(reason.contains("4 decisions") && reason.contains("expected 3"), "{reason}");
    drop(raw);
    completes(&run, learner);
}

#[tokio::test(flavor = "multi_thread")]
async fn an_episode_sent_twice_counts_once() {
    let (run, learner, address) = waiting();
    let mut raw = Raw::join(&address, hello()).await.expect("joins");
    let lease = raw.lease().await;
    for _ in 0..2 {
        raw.say(Said::Transitions(piece(&lease, 0, 3))).await;
        raw.say(Said::Finished(finished(&lease, 3))).await;
    }
    let reason = raw.refusal().await.reason;
    assert!(reason.contains("already"), "{reason}");
    drop(raw);
    completes(&run, learner);
    assert_eq!(run.metrics()[0]["transitions"], 3);
}

#[tokio::test(flavor = "multi_thread")]
async fn an_actor_that_goes_on_sending_rubbish_is_shown_the_door() {
    let (run, learner, address) = waiting();
    let mut raw = Raw::join(&address, hello()).await.expect("joins");
    for _ in 0..=herd_common::caps::REFUSALS_PER_ACTOR {
        raw.try_say(Said::Transitions(v1::Transitions::default())).await;
    }
    let end = loop {
        match raw.hear().await {
            Ok(Some(_)) => {}
            end => break end,
        }
    };
    assert_ne!(end.as_ref().err().map(tonic::Status::code), Some(Code::DeadlineExceeded), "it may stay: {end:?}");
    completes(&run, learner);
}

#[tokio::test(flavor = "multi_thread")]
async fn who_cannot_belong_is_refused_before_any_data() {
    let (run, learner, address) = waiting();
    let torque = || "0123456789abcdef".repeat(4);
    let expects = format!("expects {PROTOCOL}");
    let strangers: [(v1::Hello, Code, &[&str]); 6] = [
        (v1::Hello { protocol: 99, ..hello() }, Code::FailedPrecondition, &["protocol 99", expects.as_str()]),
        (
            v1::Hello { task_hash: torque(), task: "torque".into(), ..hello() },
            Code::FailedPrecondition,
            &["task mismatch", "torque", "0123456789ab", "gait"],
        ),
        (v1::Hello { host: "a\u{1b}[2J b".into(), ..hello() }, Code::InvalidArgument, &["host", "[a-zA-Z0-9._-]"]),
        (v1::Hello { host: "x".repeat(65), ..hello() }, Code::InvalidArgument, &["host"]),
        (v1::Hello { robots: 0, ..hello() }, Code::InvalidArgument, &["robots is 0", "1 to"]),
        (v1::Hello { robots: u32::MAX, ..hello() }, Code::InvalidArgument, &["robots", "4294967295"]),
    ];
    for (stranger, code, words) in strangers {
        let status = Raw::join(&address, stranger).await.expect_err("refused");
        assert_eq!(status.code(), code, "{status}");
        for word in words {
            assert!(status.message().contains(word), "{:?} does not name {word:?}", status.message());
        }
    }
    let status = Raw::begin(&address, Said::Heartbeat(v1::Heartbeat::default())).await.expect_err("refused");
    assert_eq!(status.code(), Code::InvalidArgument, "{status}");
    completes(&run, learner);
}

#[tokio::test(flavor = "multi_thread")]
async fn the_contract_alone_is_enough_to_write_an_actor() {
    let (run, learner, address) = waiting();
    let mut raw = Raw::join(&address, v1::Hello { robots: 2, ..hello() }).await.expect("joins");
    assert_eq!(raw.welcome.epoch, 1);
    while let Some(heard) = raw.hear().await.expect("the stream goes on") {
        use v1::learner_message::Message as Heard;
        match heard {
            Heard::Lease(lease) if lease.sigma > 0.0 => {
                raw.say(Said::Transitions(piece(&lease, 0, 2))).await;
                raw.say(Said::Transitions(piece(&lease, 2, 3))).await;
                raw.say(Said::Finished(finished(&lease, 5))).await;
            }
            Heard::Lease(evaluation) => raw.say(Said::Finished(finished(&evaluation, 5))).await,
            Heard::Refused(refused) => panic!("{}", refused.reason),
            Heard::RunComplete(_) => break,
            Heard::Committed(_) | Heard::Welcome(_) => {}
        }
    }
    drop(raw);
    learner.wait(SHORT).expect(0, &[]);
    assert_eq!(run.metrics().pop().expect("lines")["transitions"], 5 * EPISODES);
}
