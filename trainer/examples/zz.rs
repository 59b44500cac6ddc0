//! scratch
fn main() {
    for f in std::env::args().skip(1) {
        let bytes = std::fs::read(&f).unwrap();
        let loaded = poegp_trainer::loaded::LoadedBlob::from_bytes(bytes).unwrap();
        let blob = loaded.blob();
        if let poegp_protocol::blob::Correction::Elastic(e) = &blob.correction {
            println!("{f} {:?}", &e.links[..]);
            println!("payload {:?}", &e.payload[..]);
        }
    }
}
