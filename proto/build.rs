//! Compiles the .proto files in pure Rust (protox), so that nobody needs `protoc`.

use prost::Message;
use std::{env, error::Error, fs, path::PathBuf};

fn main() -> Result<(), Box<dyn Error>> {
    println!("cargo:rerun-if-changed=proto");
    let descriptors = protox::compile(["proto/herd/v1/herd.proto"], ["proto"])?;
    let out = PathBuf::from(env::var("OUT_DIR")?);
    fs::write(out.join("herd.v1.bin"), descriptors.encode_to_vec())?;
    tonic_prost_build::configure().bytes(".herd.v1").compile_fds(descriptors)?;
    Ok(())
}
