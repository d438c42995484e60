//! `.pth` files: what torch writes is decoded, what an attacker writes is refused in time.

use std::path::Path;

use guard4d_engine::error::EngineError;
use guard4d_engine::scene::pth::{PthContent, Tensor, TensorData};
use proptest::prelude::*;

use super::assert_refused;
use crate::support::fixture;
use crate::support::pth_builder::{Pickle, RawView, archive, bare, state_dict, zip};
use crate::support::{golden, shared};

fn parse(bytes: &[u8]) -> Result<PthContent, EngineError> {
    PthContent::parse(Path::new("test.pth"), bytes)
}

fn parse_bare(class: &str, view: &RawView, storage: &[u8], count: i32) -> Result<Tensor, EngineError> {
    match parse(&bare(class, view, count, storage))? {
        PthContent::Tensor(tensor) => Ok(tensor),
        PthContent::StateDict(_) => panic!("a bare tensor was written"),
    }
}

/// Runs `pickle` over a storage of four floats.
fn run(pickle: Vec<u8>) -> Result<PthContent, EngineError> {
    parse(&archive(pickle, &[0; 16]))
}

fn view(offset: i32, shape: &[i32], strides: &[i32]) -> RawView {
    RawView { offset, shape: shape.to_vec(), strides: strides.to_vec() }
}

fn le_bytes(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_le_bytes()).collect()
}

#[test]
fn a_state_dict_keeps_names_shapes_values_and_order() {
    let tensors = fixture::tensors();
    let PthContent::StateDict(read) = parse(&state_dict(&tensors)).expect("a good file") else {
        panic!("a state dict was written")
    };
    assert_eq!(read.len(), tensors.len());
    for ((name, tensor), written) in read.iter().zip(&tensors) {
        assert_eq!(name, &written.name);
        let expected = Tensor { shape: written.shape.clone(), data: TensorData::F32(written.values.clone()) };
        assert_eq!(tensor, &expected, "{name}");
    }
}

#[test]
fn every_storage_class_is_decoded() {
    let two = view(0, &[2], &[1]);
    let floats = TensorData::F32(vec![1.5, -2.0]);
    let cases: [(&str, Vec<u8>, TensorData); 10] = [
        ("FloatStorage", le_bytes(&[1.5, -2.0]), floats.clone()),
        ("DoubleStorage", [1.5_f64.to_le_bytes(), (-2.0_f64).to_le_bytes()].concat(), floats.clone()),
        ("HalfStorage", vec![0x00, 0x3E, 0x00, 0xC0], floats.clone()),
        ("BFloat16Storage", vec![0xC0, 0x3F, 0x00, 0xC0], floats),
        ("LongStorage", [7_i64.to_le_bytes(), (-1_i64).to_le_bytes()].concat(), TensorData::I64(vec![7, -1])),
        ("IntStorage", [7_i32.to_le_bytes(), (-1_i32).to_le_bytes()].concat(), TensorData::I64(vec![7, -1])),
        ("ShortStorage", [7_i16.to_le_bytes(), (-1_i16).to_le_bytes()].concat(), TensorData::I64(vec![7, -1])),
        ("CharStorage", vec![7, 0xFF], TensorData::I64(vec![7, -1])),
        ("ByteStorage", vec![7, 0xFF], TensorData::I64(vec![7, 255])),
        ("BoolStorage", vec![1, 0], TensorData::Bool(vec![true, false])),
    ];
    for (class, storage, expected) in cases {
        assert_eq!(parse_bare(class, &two, &storage, 2).expect(class).data, expected, "{class}");
    }
}

#[test]
fn offsets_and_strides_are_honoured() {
    let storage = le_bytes(&[0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0]);
    let read = |view: RawView| match parse_bare("FloatStorage", &view, &storage, 7).expect("a view inside").data {
        TensorData::F32(values) => values,
        other => panic!("floats were written: {other:?}"),
    };
    assert_eq!(read(view(1, &[2, 3], &[3, 1])), [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]);
    assert_eq!(read(view(1, &[3, 2], &[1, 3])), [1.0, 4.0, 2.0, 5.0, 3.0, 6.0], "a transposed view");
    assert_eq!(read(view(0, &[4], &[2])), [0.0, 2.0, 4.0, 6.0]);
    assert_eq!(read(view(5, &[3], &[0])), [5.0; 3], "a repeating view that is no larger than its storage");
    assert_eq!(read(view(6, &[], &[])), [6.0], "a scalar");
    assert_eq!(read(view(99, &[0, 5], &[5, 1])), [0.0; 0], "an empty tensor touches nothing");
}

#[test]
fn parameters_and_attributes_are_accepted() {
    let tensor = view(0, &[4], &[1]);
    let pickle = Pickle::new()
        .ordered_dict()
        .op(b"q\x00(")
        .text("weight")
        .global("torch._utils", "_rebuild_parameter")
        .op(b"(")
        .tensor("0", ("FloatStorage", 4), &tensor)
        .op(&[0x88])
        .ordered_dict()
        .op(b"tRu}(")
        .text("_metadata")
        .ordered_dict()
        .text("lists")
        .op(b"](NG\x3f\xf0\0\0\0\0\0\0]K\x01aeub"); // [None, 1.0, [1]]
    let PthContent::StateDict(read) = run(pickle.stop()).expect("a module's state dict") else {
        panic!("a state dict")
    };
    assert_eq!(read.len(), 1);
    assert_eq!((read[0].0.as_str(), read[0].1.shape.as_slice()), ("weight", &[4][..]));
}

#[test]
fn programs_that_would_run_code_are_refused() {
    for (module, name) in [
        ("os", "system"),
        ("posix", "system"),
        ("builtins", "eval"),
        ("__builtin__", "getattr"),
        ("torch", "load"),
        ("torch.serialization", "FloatStorage"),
        ("collections", "defaultdict"),
    ] {
        let pickle = Pickle::new().global(module, name).text("true").op(b"\x85R").stop();
        assert_refused(run(pickle), &["data.pkl byte 2", &format!("`{module}.{name}`"), "was not run"]);
    }
    let called = Pickle::new().global("torch", "FloatStorage").op(b")R").stop();
    assert_refused(run(called), &["a call that builds no tensor"]);
    let stacked = Pickle::new().text("os").text("system").op(b"\x93").stop();
    assert_refused(run(stacked), &["opcode 0x93"]);
    let instance = Pickle::new().op(b"(ios\nsystem\n").stop();
    assert_refused(run(instance), &["opcode 0x69"]);
    let state = Pickle::new().text("x").op(b"}b").stop();
    assert_refused(run(state), &["attributes for something else"]);
}

#[test]
fn a_memo_bomb_costs_no_more_than_its_program() {
    let mut pickle = Pickle::new().op(b")q\x00");
    for step in 0..60_u8 {
        pickle = pickle.op(&[b'h', step, b'h', step, 0x86, b'q', step + 1]);
    }
    // 61 tuples stay on the stack; what the last one names would have 2^60 leaves.
    assert_refused(run(pickle.stop()), &["more after its end"]);
    let nested = (0..200_000).fold(Pickle::new().op(b")"), |pickle, _| pickle.op(b"\x85"));
    assert_refused(run(nested.stop()), &["another root"]);
    let mut selfish = Pickle::new().op(b"}q\x00").text("self").op(b"h\x00s");
    selfish.0.push(b'.');
    assert_refused(run(selfish.0), &["`self`", "a tensor"]);
}

#[test]
fn sizes_that_the_program_does_not_have_are_refused() {
    assert_refused(run(Pickle::new().op(b"X\xff\xff\xff\xffabc").stop()), &["end of program", "4294967295 more bytes"]);
    assert_refused(run(Pickle::new().op(b"\x8a\xff\x01").stop()), &["data.pkl byte", "more bytes"]);
    let wide = Pickle::new().op(b"\x8a\x09").op(&[1; 9]).stop();
    assert_refused(run(wide), &["an integer of 9 bytes", "at most 8"]);
    assert_refused(run(Pickle::new().op(b"cno end").0), &["a name without end"]);
    assert_refused(run(vec![]), &["data.pkl", "end of program"]);
    assert_refused(run(vec![b'N'; 1_000_001]), &["a longer program", "at most 1000000 opcodes"]);
    assert_refused(parse(&archive(vec![b'N'; (16 << 20) + 1], &[])), &["data.pkl", "16777217 bytes"]);
}

#[test]
fn malformed_programs_are_refused() {
    for (program, word) in [
        (&b"\x80\x04."[..], "pickle protocol 4"),
        (b"\x80\x02.", "another root"),
        (b"\x80\x02N.", "another root"),
        (b"\x80\x02NN.", "more after its end"),
        (b"\x80\x02).trailing", "more after its end"),
        (b"\x80\x02t.", "too few values"),
        (b"\x80\x02R.", "too few values"),
        (b"\x80\x02q\x00.", "too few values"),
        (b"\x80\x02(\x85.", "too few values"),
        (b"\x80\x02N\x86.", "too few values"),
        (b"\x80\x02h\x05.", "memo 5"),
        (b"\x80\x02NNs.", "items for something else"),
        (b"\x80\x02)NNs.", "items for something else"),
        (b"\x80\x02}(Nu.", "a key without value"),
        (b"\x80\x02}Na.", "items for something else"),
        (b"\x80\x02}(Ne.", "items for something else"),
        (b"\x80\x02}NNs.", "a key that is no string"),
        (b"\x80\x02NQ.", "a tuple"),
        (b"\x80\x02)Q.", "another persistent id"),
        (b"\x80\x02X\x01\0\0\0\xff.", "no text"),
    ] {
        assert_refused(run(program.to_vec()), &[word]);
    }
    let twice = Pickle::new().op(b"}(").text("a").tensor("0", ("FloatStorage", 4), &view(0, &[4], &[1]));
    let twice = twice.text("a").tensor("0", ("FloatStorage", 4), &view(0, &[0], &[1])).op(b"u");
    assert_refused(run(twice.stop()), &["`a`", "present twice"]);
}

#[test]
fn views_that_leave_or_inflate_their_storage_are_refused() {
    let max = i32::MAX;
    for (bad, word) in [
        (view(0, &[1 << 20], &[0]), "at most the 4 elements"),
        (view(0, &[max, max, max, max], &[0, 0, 0, 0]), "at most the 4 elements"),
        (view(0, &[5], &[1]), "at most the 4 elements"),
        (view(1, &[4], &[1]), "inside its 4 elements"),
        (view(0, &[2, 2], &[3, 1]), "inside its 4 elements"),
        (view(0, &[2], &[max]), "inside its 4 elements"),
        (view(max, &[], &[]), "inside its 4 elements"),
        (view(0, &[4], &[1, 1]), "one stride per dimension"),
        (view(0, &[-4], &[1]), "at least 0"),
        (view(0, &[4], &[-1]), "at least 0"),
        (view(-1, &[4], &[1]), "at least 0"),
        (view(0, &[1; 9], &[1; 9]), "9 dimensions"),
    ] {
        assert_refused(parse_bare("FloatStorage", &bad, &[0; 16], 4), &[word]);
    }
    let whole = view(0, &[4], &[1]);
    for (storage, count) in [(&[0; 15][..], 4), (&[0; 17], 4), (&[0; 16], 5), (&[0; 16], max)] {
        assert_refused(parse_bare("FloatStorage", &whole, storage, count), &["elements of 4 bytes"]);
    }
    assert_refused(parse_bare("FloatStorage", &whole, &[0; 16], -1), &["at least 0"]);
    assert_refused(parse_bare("QInt8Storage", &whole, &[0; 16], 4), &["`torch.QInt8Storage`"]);
}

#[test]
fn tensors_that_share_a_storage_cannot_outgrow_the_file() {
    let tensor = view(0, &[4096], &[1]);
    let pickle = (0..100).fold(Pickle::new().op(b"}("), |pickle, index| {
        pickle.text(&index.to_string()).tensor("0", ("FloatStorage", 4096), &tensor)
    });
    assert_refused(parse(&archive(pickle.op(b"u").stop(), &[0; 4 * 4096])), &["more tensor data than the file"]);
}

#[test]
fn storages_are_found_only_by_number() {
    for key in ["", "1", "../data.pkl", "0/../0", "٣", "-0"] {
        let pickle = Pickle::new().tensor(key, ("FloatStorage", 4), &view(0, &[4], &[1])).stop();
        let word = if key == "1" { "archive/data/1" } else { "decimal digits" };
        assert_refused(run(pickle), &[word]);
    }
}

#[test]
fn archives_that_torch_does_not_write_are_refused() {
    let good = state_dict(&fixture::tensors()[..1]);
    let directory = good.windows(4).position(|w| w == b"PK\x01\x02").expect("an archive has a directory");
    let end = good.len() - 22;
    let edit = |at: usize, bytes: &[u8]| {
        let mut file = good.clone();
        file[at..at + bytes.len()].copy_from_slice(bytes);
        parse(&file)
    };
    assert_refused(edit(directory + 10, &[8, 0]), &["archive/data.pkl", "compressed", "a stored entry"]);
    assert_refused(edit(directory + 20, &[1, 0, 0, 0]), &["compressed"]);
    assert_refused(edit(directory + 8, &[1, 0]), &["encrypted"]);
    assert_refused(edit(directory + 16, &[0; 4]), &["CRC-32", "the file is damaged"]);
    assert_refused(edit(directory + 42, &[0xFF; 4]), &["cut off"]);
    assert_refused(edit(directory + 42, &[1, 0, 0, 0]), &["no local header"]);
    assert_refused(edit(directory + 46, b"A"), &["another name"]);
    assert_refused(edit(directory + 28, &[0xFF, 0xFF]), &["archive"]);
    assert_refused(edit(directory, b"XX"), &["a damaged directory"]);
    assert_refused(edit(end + 10, &[9, 0]), &["damaged directory"]);
    assert_refused(edit(end + 16, &[0xFF; 4]), &["ZIP64"]);
    assert_refused(edit(end + 12, &[0xFE, 0xFF, 0xFF, 0xFF]), &["directory outside the file"]);
    assert_refused(edit(end, b"XX"), &["no end-of-directory record"]);
    assert_refused(parse(b"\x80\x02."), &["3 bytes", "a ZIP archive"]);
    let legacy = [&b"\x80\x02\x8a\x0al\xfc\x9c\x46\xf9\x20\x6a\xa8\x50\x19."[..], &[0; 40]].concat();
    assert_refused(parse(&legacy), &["torch 1.6 or newer"]);
}

#[test]
fn entries_are_unique_complete_and_little_endian() {
    let pickle = Pickle::new().tensor("0", ("FloatStorage", 1), &view(0, &[1], &[1])).stop();
    let entry = |name: &str, data: &[u8]| (name.to_owned(), data.to_vec());
    let program = entry("a/data.pkl", &pickle);
    let storage = entry("a/data/0", &[0; 4]);
    let parse_all = |entries: &[(String, Vec<u8>)]| parse(&zip(entries));
    let others = [entry("a/version", b"3\n"), entry("a/byteorder", b"little"), entry("a/.data/serialization_id", b"1")];
    let all = [&[program.clone(), storage.clone()], &others[..]].concat();
    assert!(parse_all(&all).is_ok(), "entries that newer versions write are ignored");
    assert_refused(parse_all(std::slice::from_ref(&storage)), &["no `data.pkl`"]);
    assert_refused(parse_all(std::slice::from_ref(&program)), &["a/data/0", "missing"]);
    assert_refused(parse_all(&[program.clone(), entry("b/data/0", &[0; 4])]), &["a/data/0", "missing"]);
    assert_refused(parse_all(&[program.clone(), entry("b/data.pkl", &pickle)]), &["several `data.pkl`"]);
    assert_refused(parse_all(&[program.clone(), storage.clone(), storage.clone()]), &["a/data/0", "present twice"]);
    assert_refused(parse_all(&[program, storage, entry("a/byteorder", b"big")]), &["byteorder", "`big`", "`little`"]);
}

#[test]
fn overlapping_entries_are_refused_before_they_are_read() {
    let mut file = zip(&[("a".to_owned(), vec![0; 1 << 16])]);
    let directory = file.windows(4).position(|w| w == b"PK\x01\x02").expect("an archive has a directory");
    let record = file[directory..file.len() - 22].to_vec();
    let end = file.split_off(file.len() - 22);
    let count = 60_000_u16;
    file.truncate(directory);
    (0..count).for_each(|_| file.extend_from_slice(&record));
    file.extend_from_slice(&end);
    let end = file.len() - 22;
    file[end + 10..end + 12].copy_from_slice(&count.to_le_bytes());
    let bytes = (record.len() * usize::from(count)) as u32;
    file[end + 12..end + 16].copy_from_slice(&bytes.to_le_bytes());
    assert_refused(parse(&file), &["entries larger than the file"]);
}

#[test]
fn every_cut_of_a_file_is_an_error() {
    let file = state_dict(&fixture::tensors()[..3]);
    for length in 0..file.len() {
        assert!(parse(&file[..length]).is_err(), "the first {length} of {} bytes", file.len());
    }
}

#[test]
fn a_trained_network_of_another_kind_is_read_but_is_no_4dgaussians_model() {
    let Some(path) = shared("data/pth/deformable_standup_run256/deform.pth") else { return };
    let PthContent::StateDict(tensors) = PthContent::open(&path).expect("a real torch file") else {
        panic!("a state dict")
    };
    assert_eq!(tensors.len(), 22);
    let count: usize = tensors.iter().map(|(_, tensor)| tensor.shape.iter().product::<usize>()).sum();
    assert_eq!(count, 506_378);
    let find = |name: &str| &tensors.iter().find(|(key, _)| key == name).expect(name).1;
    assert_eq!(find("linear.0.weight").shape, [256, 84], "63 + 21 inputs, is_blender=False");
    assert_eq!(find("linear.5.weight").shape, [256, 340], "the skip connection");
    assert_eq!(find("gaussian_rotation.bias").shape, [4]);
}

#[test]
fn the_training_tensors_of_a_real_model_are_bare() {
    let folder = golden::model("dnerf_like").join("point_cloud/iteration_20000");
    let (table, accum) = (folder.join("deformation_table.pth"), folder.join("deformation_accum.pth"));
    let expected = Tensor { shape: vec![48], data: TensorData::Bool(vec![true; 48]) };
    assert_eq!(PthContent::open(&table).expect("a real torch file"), PthContent::Tensor(expected));
    let expected = Tensor { shape: vec![48, 3], data: TensorData::F32(vec![0.0; 144]) };
    assert_eq!(PthContent::open(&accum).expect("a real torch file"), PthContent::Tensor(expected));
}

proptest! {
    #[test]
    fn random_bytes_never_panic(bytes: Vec<u8>) {
        prop_assert!(parse(&bytes).is_err());
    }

    #[test]
    fn random_programs_never_panic(codes in prop::collection::vec(
        prop::sample::select(b"().GJKMNQRX]abcehjqrstu}\x85\x86\x87\x88\x89\x8a\x00\x01\n".to_vec()), 0..60)) {
        drop(run(Pickle::new().op(&codes).stop()));
    }

    #[test]
    fn damaged_files_never_panic(at: prop::sample::Index, value: u8) {
        let mut file = state_dict(&fixture::tensors()[..2]);
        let at = at.index(file.len());
        file[at] = value;
        drop(parse(&file));
    }

    #[test]
    fn damaged_programs_never_panic(at: prop::sample::Index, value: u8) {
        let mut pickle = Pickle::new().op(b"}(").text("a").tensor("0", ("FloatStorage", 4), &view(0, &[2, 2], &[2, 1]));
        let at = at.index(pickle.0.len());
        pickle.0[at] = value;
        drop(run(pickle.op(b"u").stop()));
    }
}
