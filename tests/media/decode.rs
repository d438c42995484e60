//! Video as the ffmpeg program reads it for us: what is honoured, what is refused, and what is told.

use std::fs;
use std::process::Command;

use guard4d_engine::media::encode::EncodeOptions;
use guard4d_engine::media::png::write_png_folder;
use guard4d_engine::media::{Frame, Integrity, ReadOptions, read_clip};

use super::{code, ffmpeg, pngs, psnr, read, smooth, written};

#[test]
fn range_and_matrix_tags_are_honoured() {
    if !crate::support::has_ffmpeg() {
        return;
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    let want = [200_u8, 40, 60];
    for (matrix, range) in
        [("bt709", "tv"), ("smpte170m", "tv"), ("bt470bg", "pc"), ("bt2020nc", "tv"), ("bt709", "pc")]
    {
        let path = folder.path().join(format!("{matrix}_{range}.mkv"));
        let name = match matrix {
            "bt470bg" => "bt470",
            "bt2020nc" => "bt2020",
            same => same,
        };
        let words = format!(
            "-f lavfi -i color=0xC8283C:s=64x64:d=0.2:r=10,format=rgb24 \
             -vf scale=out_color_matrix={name}:out_range={range},format=yuv444p -c:v ffv1 \
             -colorspace {matrix} -color_range {range}"
        );
        ffmpeg(&words, &path);
        let clip = read(&path);
        // Three roundings of at most one level each; BT.601 for BT.709 moves green by 17.
        let close = |p: &[u8]| p.iter().zip(want).all(|(&g, w)| g.abs_diff(w) <= 3);
        assert!(clip.frames()[0].rgb().chunks(3).all(close), "{matrix} {range}: {:?}", &clip.frames()[0].rgb()[..3]);
    }
}

#[test]
fn untagged_video_is_bt601_below_720_lines_and_bt709_from_there() {
    if !crate::support::has_ffmpeg() {
        return;
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    for (size, matrix) in [("64x64", "smpte170m"), ("64x720", "bt709")] {
        let path = folder.path().join("untagged.y4m");
        let words = format!(
            "-f lavfi -i color=0xC8283C:s={size}:d=0.1:r=10,format=rgb24 \
             -vf scale=out_color_matrix={matrix}:out_range=tv,format=yuv420p -f yuv4mpegpipe"
        );
        ffmpeg(&words, &path);
        let clip = read(&path);
        let got = &clip.frames()[0].rgb()[..3];
        // As above.
        assert!(got.iter().zip([200_u8, 40, 60]).all(|(g, w)| g.abs_diff(w) <= 3), "{size}: {got:?}");
    }
}

#[test]
fn lossless_video_and_png_folder_hash_alike() {
    if !crate::support::has_ffmpeg() {
        return;
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    let frames: Vec<_> = (0..3).map(|t| smooth(33, 17, t)).collect();
    let pngs = folder.path().join("pngs");
    write_png_folder(&pngs, &frames).expect("the folder is writable");
    let video = folder.path().join("lossless.mkv");
    ffmpeg(&format!("-i {}/%05d.png -c:v ffv1 -pix_fmt bgr0", pngs.display()), &video);
    assert_eq!(read(&video).digest(), read(&pngs).digest());
    assert_eq!(read(&video).size_px(), (33, 17));
}

#[test]
fn variable_frame_rate_and_rotation_are_taken_as_stored() {
    if !crate::support::has_ffmpeg() {
        return;
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    let [plain, slow, turned] = ["p.mp4", "slow.mp4", "turned.mp4"].map(|name| folder.path().join(name));
    ffmpeg("-f lavfi -i testsrc=s=64x32:r=10:d=1 -pix_fmt yuv420p", &plain);
    let input = plain.display();
    ffmpeg(&format!("-i {input} -vf setpts=N*N/10/TB -fps_mode passthrough -pix_fmt yuv420p"), &slow);
    assert_eq!(read(&slow).frames().len(), 10, "no frame is repeated to fill gaps");

    // From version 6 on, ffmpeg writes what its input option says, and no longer what the old tag says.
    let old = Command::new("ffmpeg").arg("-version").output().expect("has_ffmpeg was asked");
    let version = String::from_utf8_lossy(&old.stdout);
    let major: u32 = version.split(|c: char| !c.is_ascii_digit()).find_map(|n| n.parse().ok()).expect("a version");
    match major {
        ..6 => ffmpeg(&format!("-i {input} -c copy -metadata:s:v rotate=90"), &turned),
        _ => ffmpeg(&format!("-display_rotation 90 -i {input} -c copy"), &turned),
    }
    let (plain, turned) = (read(&plain), read(&turned));
    assert_eq!(turned.size_px(), (32, 64), "upright");
    // Against the clock: the right column becomes the upper row.
    let turn = |frame: &Frame| {
        let at = |x: usize, y: usize| frame.rgb()[3 * (y * 64 + x)..][..3].to_vec();
        let rows = (0..64).flat_map(|y| (0..32).map(move |x| (63 - y, x)));
        Frame::new(32, 64, rows.flat_map(|(x, y)| at(x, y)).collect()).expect("the length fits")
    };
    let want: Vec<_> = plain.frames().iter().map(turn).collect();
    // Chroma is enlarged after turning, which this coarse picture shows; turned otherwise, it is at 2 dB.
    let db = psnr(turned.frames(), &want);
    assert!(db > 25.0, "{db} dB");
}

#[test]
fn transparency_is_laid_over_the_background() {
    if !crate::support::has_ffmpeg() {
        return;
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("clear.mkv");
    ffmpeg("-f lavfi -i color=red@0.0:s=16x16:d=0.1:r=10,format=rgba -c:v ffv1 -pix_fmt bgra", &path);
    let options = ReadOptions { background: [10, 20, 30], ..ReadOptions::default() };
    let clip = read_clip(&path, &options).expect("a sound file");
    assert_eq!(clip.frames()[0].rgb()[..3], [10, 20, 30]);
}

#[test]
fn corrupt_and_strange_files_are_refused_and_damage_is_told() {
    if !crate::support::has_ffmpeg() {
        return;
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    let frames: Vec<_> = (0..30).map(|t| smooth(96, 64, 5 * t)).collect();
    let path = written(folder.path(), &frames, &EncodeOptions::default());
    let whole = fs::read(&path).expect("written above");
    let bad = folder.path().join("bad.mp4");
    let refuse = |bytes: &[u8]| {
        fs::write(&bad, bytes).expect("the folder is writable");
        code(read_clip(&bad, &ReadOptions::default()))
    };
    assert_eq!(refuse(b""), 65, "empty");
    assert_eq!(refuse(b"this is no video at all, only words and words"), 65, "text");
    assert_eq!(refuse(&whole[..200]), 65, "cut in the index");
    assert_eq!(code(read_clip(&folder.path().join("nowhere.mp4"), &ReadOptions::default())), 66);

    fs::write(&bad, &whole[..whole.len() * 3 / 4]).expect("the folder is writable");
    let cut = read(&bad);
    assert!(
        matches!(cut.integrity(), Integrity::Damaged { messages } if !messages.is_empty()),
        "{:?}",
        cut.integrity()
    );
    assert!(cut.frames().len() < 30, "{} frames", cut.frames().len());

    let sound = folder.path().join("sound.mp4");
    ffmpeg("-f lavfi -i anullsrc=d=0.1", &sound);
    assert_eq!(code(read_clip(&sound, &ReadOptions::default())), 65, "no video stream");
    let playlist = folder.path().join("list.mp4");
    fs::write(&playlist, "#EXTM3U\n#EXTINF:1,\nhttp://example.invalid/x.ts\n").expect("the folder is writable");
    assert_eq!(code(read_clip(&playlist, &ReadOptions::default())), 65, "a playlist reaches no other place");
}

#[test]
fn video_of_ten_bits_is_rounded_to_eight() {
    if !crate::support::has_ffmpeg() {
        return;
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    let frames: Vec<_> = (0..4).map(|t| smooth(96, 64, t)).collect();
    let input = pngs(folder.path(), &frames);
    let to_video = "scale=out_color_matrix=bt709:out_range=tv:flags=accurate_rnd+full_chroma_int";
    // Measured 52 dB after H.265, 54 after VP9, and nothing lost without a lossy codec; another matrix leaves 29.
    for (name, arguments, least_db) in [
        ("h265.mkv", "-c:v libx265 -x265-params log-level=error -crf 8 -pix_fmt yuv420p10le", 48.0),
        ("yuv444.mkv", "-c:v ffv1 -pix_fmt yuv444p10le", 60.0),
        ("vp9.webm", "-c:v libvpx-vp9 -profile:v 2 -crf 8 -b:v 0 -pix_fmt yuv420p10le", 48.0),
    ] {
        let path = folder.path().join(name);
        let tags = "-colorspace bt709 -color_primaries bt709 -color_trc bt709 -color_range tv";
        ffmpeg(&format!("-i {input} -vf {to_video} {arguments} {tags}"), &path);
        let db = psnr(read(&path).frames(), &frames);
        assert!(db > least_db, "{name}: {db} dB");
    }
    // Levels of 8 bits lie 4 levels of 10 bits apart, so that they come back exactly if nothing adds noise.
    let path = folder.path().join("rgb.mkv");
    ffmpeg(&format!("-i {input} -c:v ffv1 -pix_fmt gbrp10le"), &path);
    let clip = read(&path);
    assert_eq!(clip.frames(), frames, "RGB of 10 bits");
}

#[test]
fn transparency_is_laid_over_the_background_in_every_codec_that_has_it() {
    if !crate::support::has_ffmpeg() {
        return;
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    // Opaque on the left, clear on the right: 16-px halves, so that chroma of half resolution does not mix them.
    let source = "-f lavfi -i color=0xC8283C:s=64x32:d=0.3:r=10,format=rgba,\
                  geq=r='r(X,Y)':g='g(X,Y)':b='b(X,Y)':a='255*lt(X,32)'";
    // Lossless ones are off by nothing; VP9 goes through limited range and a codec.
    for (name, arguments, most) in [
        ("qtrle.mov", "-c:v qtrle -pix_fmt argb", 0),
        ("png.mov", "-c:v png -pix_fmt rgba", 0),
        ("ffv1.mkv", "-c:v ffv1 -pix_fmt bgra", 0),
        ("vp9.webm", "-c:v libvpx-vp9 -crf 4 -b:v 0 -pix_fmt yuva420p -auto-alt-ref 0", 6),
    ] {
        let path = folder.path().join(name);
        ffmpeg(&format!("{source} {arguments}"), &path);
        let options = ReadOptions { background: [10, 220, 30], ..ReadOptions::default() };
        let clip = read_clip(&path, &options).unwrap_or_else(|error| panic!("{name}: {error}"));
        assert_eq!((clip.frames().len(), clip.size_px()), (3, (64, 32)), "{name}");
        let pixel = |x: usize| &clip.frames()[1].rgb()[3 * (16 * 64 + x)..][..3];
        for (x, want) in [(8, [200, 40, 60]), (56, [10, 220, 30])] {
            let off = pixel(x).iter().zip(want).map(|(got, want)| got.abs_diff(want)).max();
            assert!(off <= Some(most), "{name} at {x}: {:?}", pixel(x));
        }
    }
}
