//! What any gRPC tool finds on a learner: health, reflection, policies; and what it cannot hold open.

use herd_common::caps;
use herd_proto::client::Client;
use herd_tests::Run;
use herd_tests::patience::{SHORT, eventually};
use std::io::Read;
use std::net::TcpStream;
use std::time::Duration;
use tokio_stream::{StreamExt, iter};
use tonic::transport::{Channel, Endpoint};
use tonic_health::pb::health_check_response::ServingStatus;
use tonic_health::pb::{HealthCheckRequest, health_client::HealthClient};

const EXPECTED: [&str; 4] = ["grpc.health.v1.Health", "herd.v1.Policies", "herd.v1.Training", "herd.v1.Work"];

async fn channel(address: &str) -> Channel {
    let url = format!("http://{address}");
    Endpoint::from_shared(url).expect("an address").connect().await.expect("the learner listens")
}

/// Asks a reflection service of one version for the names of all services.
macro_rules! listed_services {
    ($version:ident, $address:expr) => {{
        use tonic_reflection::pb::$version::{
            ServerReflectionRequest, server_reflection_client::ServerReflectionClient,
            server_reflection_request::MessageRequest, server_reflection_response::MessageResponse,
        };
        let message_request = Some(MessageRequest::ListServices(String::new()));
        let request = ServerReflectionRequest { host: String::new(), message_request };
        let mut client = ServerReflectionClient::new(channel($address).await);
        let answers = client.server_reflection_info(iter([request])).await.expect("answers");
        let answer = answers.into_inner().next().await.expect("one answer").expect("no error");
        match answer.message_response {
            Some(MessageResponse::ListServicesResponse(list)) => {
                list.service.into_iter().map(|service| service.name).collect::<Vec<_>>()
            }
            other => panic!("expected a list of services, got {other:?}"),
        }
    }};
}

#[tokio::test(flavor = "multi_thread")]
async fn reflection_lists_the_services_in_both_versions() {
    let run = Run::new(4);
    let _learner = run.learner();
    let address = run.address();
    for found in [listed_services!(v1, &address), listed_services!(v1alpha, &address)] {
        for service in EXPECTED {
            assert!(found.iter().any(|name| name == service), "no {service} in {found:?}");
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_learner_that_is_ready_is_healthy() {
    let run = Run::new(4);
    let _learner = run.learner();
    let address = run.address();
    run.ask(&["wait-ready", "--learner", &address]).expect(0, &[]);
    let mut client = HealthClient::new(channel(&address).await);
    for service in ["", "herd.v1.Work"] {
        let answer = client.check(HealthCheckRequest { service: service.into() }).await.expect("answers");
        assert_eq!(answer.into_inner().status(), ServingStatus::Serving, "{service:?}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn policies_can_be_had_by_version_and_unknown_ones_are_named() {
    let run = Run::new(4);
    let _learner = run.learner();
    let client = Client::connect(&run.address()).await.expect("the learner listens");
    let policy = client.policy(0).await.expect("the untrained policy");
    assert_eq!(policy.provenance.version, 0);
    let error = client.policy(77).await.expect_err("there is none").to_string();
    assert!(error.contains("NotFound") && error.contains("77"), "{error}");
}

#[test]
fn a_silent_connection_is_closed() {
    let run = Run::new(4);
    let _learner = run.learner();
    let mut silent = TcpStream::connect(run.address()).expect("the learner listens");
    silent.set_read_timeout(Some(Duration::from_millis(200))).expect("a timeout can be set");
    // The learner may greet first, as HTTP/2 allows; the end of the stream or a reset is what must come.
    let mut bytes = [0; 1024];
    eventually(caps::HANDSHAKE_TIMEOUT + SHORT, "the learner closes a connection without a word", || {
        match silent.read(&mut bytes) {
            Ok(0) => Some(()),
            Ok(_) => None,
            Err(error) => (!matches!(error.kind(), std::io::ErrorKind::WouldBlock)).then_some(()),
        }
    });
}
