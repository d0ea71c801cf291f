//! Accepting connections with bounds: how many, and how long until the first byte.
//!
//! hyper never closes a connection that sends nothing, and a plain accept loop spins when file descriptors run out.

use super::Traffic;
use herd_common::caps;
use std::io;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, mpsc};
use tokio::time::Sleep;
use tokio_stream::wrappers::ReceiverStream;
use tonic::transport::server::{Connected, TcpConnectInfo};

/// Length of the HTTP/2 connection preface.
const PREFACE_BYTES: usize = 24;
/// Pause after a failed accept: long enough not to spin, short enough not to be noticed.
const ACCEPT_PAUSE: Duration = Duration::from_millis(100);

/// A connection that holds one of the places, and must send its preface in time.
pub(super) struct Guarded {
    io: TcpStream,
    unseen: usize,
    deadline: Pin<Box<Sleep>>,
    traffic: Arc<Traffic>,
    _place: OwnedSemaphorePermit,
}

/// The accepted connections of `listener`, their bytes counted.
pub(super) fn guarded(listener: TcpListener, traffic: Arc<Traffic>) -> ReceiverStream<io::Result<Guarded>> {
    let (sender, receiver) = mpsc::channel(16);
    tokio::spawn(async move {
        let places = Arc::new(Semaphore::new(caps::CONNECTIONS));
        while let Ok(place) = places.clone().acquire_owned().await {
            tokio::select! {
                () = sender.closed() => return,
                accepted = listener.accept() => match accepted {
                    Ok((io, _)) => {
                        let _ = io.set_nodelay(true);
                        let deadline = Box::pin(tokio::time::sleep(caps::HANDSHAKE_TIMEOUT));
                        let traffic = traffic.clone();
                        let connection = Guarded { io, unseen: PREFACE_BYTES, deadline, traffic, _place: place };
                        if sender.send(Ok(connection)).await.is_err() {
                            return;
                        }
                    }
                    Err(error) => {
                        tracing::warn!(%error, "cannot accept a connection");
                        tokio::time::sleep(ACCEPT_PAUSE).await;
                    }
                },
            }
        }
    });
    ReceiverStream::new(receiver)
}

impl Guarded {
    /// Counts what a write took.
    fn count(&self, written: Poll<io::Result<usize>>) -> Poll<io::Result<usize>> {
        if let Poll::Ready(Ok(bytes)) = &written {
            self.traffic.add_sent(*bytes);
        }
        written
    }
}

impl Connected for Guarded {
    type ConnectInfo = TcpConnectInfo;

    fn connect_info(&self) -> Self::ConnectInfo {
        self.io.connect_info()
    }
}

impl AsyncRead for Guarded {
    fn poll_read(mut self: Pin<&mut Self>, cx: &mut Context<'_>, buffer: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        let before = buffer.filled().len();
        let read = Pin::new(&mut self.io).poll_read(cx, buffer);
        self.traffic.add_received(buffer.filled().len() - before);
        if self.unseen > 0 {
            self.unseen = self.unseen.saturating_sub(buffer.filled().len() - before);
            if self.unseen > 0 && self.deadline.as_mut().poll(cx).is_ready() {
                return Poll::Ready(Err(io::Error::new(io::ErrorKind::TimedOut, "no HTTP/2 preface in time")));
            }
        }
        read
    }
}

impl AsyncWrite for Guarded {
    fn poll_write(mut self: Pin<&mut Self>, cx: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        let written = Pin::new(&mut self.io).poll_write(cx, bytes);
        self.count(written)
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.io).poll_flush(cx)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.io).poll_shutdown(cx)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        slices: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let written = Pin::new(&mut self.io).poll_write_vectored(cx, slices);
        self.count(written)
    }

    fn is_write_vectored(&self) -> bool {
        self.io.is_write_vectored()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tokio::io::{AsyncReadExt, AsyncWriteExt};
    use tokio_stream::StreamExt;

    async fn pair() -> (TcpStream, Guarded) {
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("binds");
        let address = listener.local_addr().expect("bound");
        let traffic = Arc::new(Traffic::default());
        let mut incoming = guarded(listener, traffic);
        let client = TcpStream::connect(address).await.expect("connects");
        let server = incoming.next().await.expect("accepts").expect("works");
        (client, server)
    }

    #[tokio::test]
    async fn a_silent_connection_is_closed() {
        let (mut client, mut server) = pair().await;
        client.write_all(&[b'P'; PREFACE_BYTES - 1]).await.expect("writes");
        tokio::time::pause();
        let mut bytes = [0; 64];
        assert_eq!(server.read(&mut bytes).await.expect("reads"), PREFACE_BYTES - 1);
        assert_eq!(server.read(&mut bytes).await.expect_err("closed").kind(), io::ErrorKind::TimedOut);
    }

    #[tokio::test]
    async fn a_connection_that_spoke_may_be_silent() {
        let (mut client, mut server) = pair().await;
        client.write_all(&[b'P'; PREFACE_BYTES]).await.expect("writes");
        let mut bytes = [0; 64];
        assert_eq!(server.read(&mut bytes).await.expect("reads"), PREFACE_BYTES);
        tokio::time::pause();
        let silence = tokio::time::timeout(caps::HANDSHAKE_TIMEOUT * 10, server.read(&mut bytes)).await;
        assert!(silence.is_err(), "still open");
    }
}
