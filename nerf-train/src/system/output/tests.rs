use super::*;
use std::cell::RefCell;
use std::rc::Rc;
use std::sync::Barrier;

type Look = Box<dyn Fn(&File)>;

thread_local! {
    /// Function called with each file or folder that this thread is about to sync.
    static AT_SYNC: RefCell<Option<Look>> = const { RefCell::new(None) };
}

pub(super) fn at_sync(file: &File) {
    AT_SYNC.with_borrow(|look| look.iter().for_each(|look| look(file)));
}

fn names_in(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> = fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().file_name().to_string_lossy().into_owned())
        .collect();
    names.sort();
    names
}

#[test]
fn a_file_appears_only_on_commit() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.txt");
    let mut file = AtomicFile::create(&path).unwrap();
    file.write_all(b"hello").unwrap();
    assert!(!path.exists());
    file.commit().unwrap();
    assert_eq!(fs::read(&path).unwrap(), b"hello");
    assert_eq!(names_in(folder.path()), ["a.txt"]);
}

#[test]
fn dropping_without_commit_leaves_the_old_file_and_no_temporary() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.txt");
    write_atomic(&path, b"old").unwrap();
    let mut file = AtomicFile::create(&path).unwrap();
    file.write_all(b"half of the new").unwrap();
    drop(file);
    assert_eq!(fs::read(&path).unwrap(), b"old");
    assert_eq!(names_in(folder.path()), ["a.txt"]);
}

#[test]
fn seeking_back_overwrites() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.txt");
    let mut file = AtomicFile::create(&path).unwrap();
    file.write_all(b"....body").unwrap();
    file.seek(SeekFrom::Start(0)).unwrap();
    file.write_all(b"head").unwrap();
    file.commit().unwrap();
    assert_eq!(fs::read(&path).unwrap(), b"headbody");
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_is_a_write_error_that_names_the_path() {
    // The short write fails when the buffer is flushed at commit; the long one bypasses the buffer.
    for size in [10, 10 * BUFFER_BYTES] {
        let error = write_atomic("/dev/full", &vec![7; size]).unwrap_err();
        assert_eq!(error.attempt, Attempt::Write);
        let message = error.to_string();
        assert!(message.contains("cannot write the file /dev/full: No space left"), "{message}");
    }
}

#[cfg(target_os = "linux")]
#[test]
fn a_failed_write_that_was_passed_over_still_fails_the_commit() {
    let mut file = AtomicFile::create("/dev/full").unwrap();
    let _ = file.write(&vec![7; 2 * BUFFER_BYTES]);
    let error = file.commit().unwrap_err();
    assert_eq!(error.attempt, Attempt::Write);
}

#[cfg(target_os = "linux")]
#[test]
fn a_device_is_written_and_never_replaced() {
    write_atomic("/dev/null", b"gone").unwrap();
    assert!(!fs::metadata("/dev/null").unwrap().is_file());
}

#[test]
fn a_path_under_a_regular_file_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("file");
    write_atomic(&file, b"x").unwrap();
    let below = file.join("deeper").join("a.txt");
    let error = write_atomic(&below, b"y").unwrap_err();
    assert_eq!(error.attempt, Attempt::Create);
    assert!(error.to_string().contains("deeper"), "{error}");
    let error = ensure_folder(file.join("deeper")).unwrap_err();
    assert_eq!(error.attempt, Attempt::CreateFolder);
    assert!(error.to_string().starts_with("cannot create the folder"), "{error}");
}

#[test]
fn a_missing_folder_and_a_folder_as_target_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let error = write_atomic(folder.path().join("no/such/a.txt"), b"y").unwrap_err();
    assert_eq!(error.attempt, Attempt::Create);
    assert!(error.to_string().contains("No such file") || !cfg!(unix), "{error}");
    assert!(!error.to_string().contains(".nerf-"), "{error}");
    let error = write_atomic(folder.path(), b"y").unwrap_err();
    assert!(error.to_string().contains("it is a folder"), "{error}");
    assert!(write_atomic("", b"y").is_err());
    assert!(write_atomic("..", b"y").is_err());
}

#[cfg(target_os = "linux")]
#[test]
fn a_folder_where_nothing_can_be_written_is_found_by_the_probe() {
    // Even root cannot create files in /proc.
    let error = ensure_folder("/proc").unwrap_err();
    assert_eq!(error.attempt, Attempt::ProbeFolder);
}

#[test]
fn ensure_folder_creates_parents_and_leaves_nothing_in_it() {
    let folder = tempfile::tempdir().unwrap();
    let deep = folder.path().join("a/b/c");
    ensure_folder(&deep).unwrap();
    ensure_folder(&deep).unwrap();
    assert!(names_in(&deep).is_empty());
}

#[test]
fn of_many_writers_of_one_name_one_wins_whole() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("contested");
    let barrier = Barrier::new(4);
    std::thread::scope(|scope| {
        for byte in 0..4_u8 {
            let (path, barrier) = (&path, &barrier);
            scope.spawn(move || {
                barrier.wait();
                for _ in 0..10 {
                    write_atomic(path, &vec![byte; 200_000]).unwrap();
                }
            });
        }
    });
    let bytes = fs::read(&path).unwrap();
    assert_eq!(bytes.len(), 200_000);
    assert!(bytes.iter().all(|&byte| byte == bytes[0]));
    assert_eq!(names_in(folder.path()), ["contested"]);
}

#[cfg(unix)]
#[test]
fn permissions_are_those_of_an_ordinary_file_and_a_replaced_file_keeps_its_own() {
    use std::os::unix::fs::PermissionsExt;
    let mode = |path: &Path| fs::metadata(path).unwrap().permissions().mode() & 0o777;
    let folder = tempfile::tempdir().unwrap();
    let (ours, ordinary) = (folder.path().join("ours"), folder.path().join("ordinary"));
    write_atomic(&ours, b"x").unwrap();
    fs::write(&ordinary, b"x").unwrap();
    assert_eq!(mode(&ours), mode(&ordinary));
    fs::set_permissions(&ours, fs::Permissions::from_mode(0o640)).unwrap();
    write_atomic(&ours, b"y").unwrap();
    assert_eq!(mode(&ours), 0o640);
}

#[cfg(unix)]
#[test]
fn a_symbolic_link_stays_a_link() {
    let folder = tempfile::tempdir().unwrap();
    let (real, link) = (folder.path().join("real"), folder.path().join("link"));
    write_atomic(&real, b"old").unwrap();
    std::os::unix::fs::symlink("real", &link).unwrap();
    write_atomic(&link, b"new").unwrap();
    assert_eq!(fs::read(&real).unwrap(), b"new");
    assert!(fs::symlink_metadata(&link).unwrap().file_type().is_symlink());
}

#[cfg(unix)]
#[test]
fn all_bytes_are_synced_before_the_rename_and_the_folder_after_it() {
    use std::os::unix::fs::MetadataExt;
    let folder = tempfile::tempdir().unwrap();
    let (replaced, new) = (folder.path().join("replaced"), folder.path().join("new"));
    write_atomic(&replaced, b"old").unwrap();
    let atomic = |path: &Path| write_atomic(path, b"whole").map(|()| true);
    let once = |path: &Path| write_new(path, b"whole");
    type Way<'a> = &'a dyn Fn(&Path) -> Result<bool, OutputError>;
    let cases: [(&Path, Way<'_>, Option<&[u8]>); 3] =
        [(&replaced, &atomic, Some(b"old")), (&new, &once, None), (&folder.path().join("c"), &atomic, None)];
    for (path, write, before) in cases {
        // For each sync: whether the folder is synced, else the file's length, and the contents under the final name.
        let seen = Rc::new(RefCell::new(Vec::new()));
        let look = {
            let (seen, path, inode) =
                (seen.clone(), path.to_owned(), folder.path().metadata().unwrap().ino());
            move |file: &File| {
                let metadata = file.metadata().unwrap();
                let bytes = (!metadata.is_dir()).then_some(metadata.len());
                seen.borrow_mut().push((metadata.ino() == inode, bytes, fs::read(&path).ok()));
            }
        };
        AT_SYNC.set(Some(Box::new(look)));
        assert!(write(path).unwrap());
        AT_SYNC.set(None);
        let file = (false, Some(5), before.map(<[u8]>::to_vec));
        assert_eq!(*seen.borrow(), [file, (true, None, Some(b"whole".to_vec()))], "{}", path.display());
    }
}
