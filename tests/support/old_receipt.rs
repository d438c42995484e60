//! Receipts and keys as they were before receipts bound their reader, written here once more.

use guard4d_engine::base::digest::Digest;
use guard4d_engine::base::prf::{MasterSecret, Prf};
use guard4d_engine::base::tensor_file::{Tensor, TensorFile};
use guard4d_engine::networks::clip::ClipModel;
use guard4d_engine::release::receipt::ReceiptBody;
use guard4d_engine::watermark::key::owner_key::Key;
use guard4d_engine::watermark::key::tokens::{TokenTable, Vocabulary};
use serde_json::{Value, json};

use super::owner::sealed;

/// Domain of their commitments.
const CONTEXT: &str = "guard4d receipt commitment, version 1";

/// A receipt of an older version over this body.
pub(crate) fn seal(schema: &str, body: &ReceiptBody) -> String {
    let mut body = serde_json::to_value(body).expect("finite figures");
    let promise = body["promise"].as_object_mut().expect("an object");
    promise.remove("anchor");
    let commitment = commitment(CONTEXT, &body);
    json!({ "schema": schema, "body": body, "commitment": commitment.to_string() }).to_string()
}

/// Hash of a body: every field in the order of names, each value with a tag and its length.
pub(crate) fn commitment(context: &str, body: &Value) -> Digest {
    let mut bytes = Vec::new();
    write(body, &mut bytes);
    Digest::from_bytes(blake3::derive_key(context, &bytes))
}

fn write(value: &Value, out: &mut Vec<u8>) {
    let mut tagged = |tag: u8, bytes: &[u8]| {
        out.push(tag);
        out.extend((bytes.len() as u64).to_le_bytes());
        out.extend(bytes);
    };
    match value {
        Value::Null => tagged(b'0', b""),
        Value::Bool(yes) => tagged(b'b', &[u8::from(*yes)]),
        Value::String(text) => tagged(b's', text.as_bytes()),
        Value::Number(n) if n.is_u64() => tagged(b'u', &n.as_u64().expect("asked").to_le_bytes()),
        Value::Number(n) if n.is_i64() => tagged(b'i', &n.as_i64().expect("asked").to_le_bytes()),
        Value::Number(n) => tagged(b'f', &n.as_f64().expect("a double").to_bits().to_le_bytes()),
        Value::Array(items) => {
            tagged(b'[', &(items.len() as u64).to_le_bytes());
            items.iter().for_each(|item| write(item, out));
        }
        Value::Object(fields) => {
            tagged(b'{', &(fields.len() as u64).to_le_bytes());
            let mut names: Vec<&String> = fields.keys().collect();
            names.sort();
            for name in names {
                write(&Value::from(name.as_str()), out);
                write(&fields[name], out);
            }
        }
    }
}

/// A key of the first version with a new key's secret, decoder and codes: its table follows from the master secret.
pub(crate) fn key(key: &Key, clip: &ClipModel) -> TensorFile {
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    let path = folder.path().join("owner.key");
    key.write(&path, guard4d_engine::base::output::Existing::Refuse).expect("writable");
    let mut file = TensorFile::read(&path).expect("written above");
    let mut secret = [0; 32];
    for (byte, pair) in secret.iter_mut().zip(file.meta["secret"].as_bytes().chunks(2)) {
        *byte = u8::from_str_radix(std::str::from_utf8(pair).expect("digits"), 16).expect("digits");
    }
    let text = &clip.config().text_config;
    let vocabulary = Vocabulary { size: text.vocab_size as u32, context: text.max_position_embeddings as u32 };
    let prf = Prf::new(&MasterSecret::from_bytes(secret));
    let table = TokenTable::derive(&prf, vocabulary, key.num_bits()).expect("the vocabulary is large");
    let ids = table.ids().as_flattened().to_vec();
    file.tensors.insert("token_table".to_owned(), Tensor::u32(&[key.bits(), 2], ids));
    file.meta.insert("format".to_owned(), "guard4d.key/1".to_owned());
    sealed(file)
}
