//! Where a learner is: an address, or a file that holds one.
//!
//! An engine that places the learner first lets it write its address into a file that every machine sees. Whoever
//! looks for it reads that file again at each try, so a learner that moved is found without a restart.

use crate::client::Error;
use herd_common::caps;
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// Address of a learner as users write it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Address {
    /// `HOST:PORT` or `http://HOST:PORT`.
    Direct(String),
    /// `file:PATH`: the file's first line is `HOST:PORT`.
    File(PathBuf),
}

impl Address {
    /// The address in `address` of a run directory, which the learner writes when it listens.
    pub fn of_run(run_dir: &Path) -> Self {
        Self::File(run_dir.join("address"))
    }

    /// `HOST:PORT` as of now; a file that is missing or empty is a learner that is not there yet.
    pub fn resolve(&self) -> Result<String, Error> {
        let path = match self {
            Self::Direct(address) => return Ok(address.clone()),
            Self::File(path) => path,
        };
        let unreachable = |reason: String| Error::Unreachable { address: self.to_string(), reason };
        let text = std::fs::read_to_string(path).map_err(|e| unreachable(e.to_string()))?;
        let line = text.lines().next().unwrap_or("").trim();
        if line.is_empty() {
            return Err(unreachable("the file is empty".into()));
        }
        check(line).map_err(unreachable)?;
        Ok(line.to_owned())
    }
}

impl FromStr for Address {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self, Error> {
        let checked = match text.strip_prefix("file:") {
            Some("") => Err("it names no file".to_owned()),
            Some(path) => return Ok(Self::File(path.into())),
            None => check(text),
        };
        checked.map_err(|reason| Error::Address { address: text.into(), reason })?;
        Ok(Self::Direct(text.into()))
    }
}

impl std::fmt::Display for Address {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Direct(address) => f.write_str(address),
            Self::File(path) => write!(f, "file:{}", path.display()),
        }
    }
}

/// Refuses what cannot be `[http://]HOST:PORT`, before anybody waits for it.
fn check(text: &str) -> Result<(), String> {
    if text.len() > caps::ADDRESS_BYTES {
        return Err(format!("{} bytes, at most {} make sense", text.len(), caps::ADDRESS_BYTES));
    }
    let authority = text.strip_prefix("http://").unwrap_or(text).trim_end_matches('/');
    let (host, port) = authority.rsplit_once(':').ok_or("it has no port")?;
    if host.is_empty() || host.contains(['/', ' ']) {
        return Err("it has no host".into());
    }
    match port.parse::<u16>() {
        Ok(1..) => Ok(()),
        _ => Err(format!("port {port:?} is not a number from 1 to 65535")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_come_back() {
        for text in ["127.0.0.1:7447", "http://node-1:7447", "[::1]:7447", "file:/runs/a/address"] {
            assert_eq!(text.parse::<Address>().expect("an address").to_string(), text);
        }
    }

    #[test]
    fn what_is_no_address_is_named() {
        for (text, reason) in [
            ("node-1", "no port"),
            ("node-1:0", "port \"0\""),
            ("node-1:70000", "port \"70000\""),
            (":7447", "no host"),
            ("file:", "no file"),
            ("ftp://node-1:7447", "no host"),
        ] {
            let error = text.parse::<Address>().expect_err(text).to_string();
            assert!(error.contains(reason), "{error}");
        }
    }

    #[test]
    fn a_file_is_read_at_each_try() {
        let path = std::env::temp_dir().join(format!("herd-address-{}", std::process::id()));
        let address = Address::File(path.clone());
        assert!(address.resolve().expect_err("no file yet").is_transient());
        for text in ["10.0.0.1:7447", "10.0.0.2:7447"] {
            std::fs::write(&path, format!("{text}\n")).expect("writes");
            assert_eq!(address.resolve().expect("reads"), text);
        }
        std::fs::remove_file(path).expect("removes");
    }
}
