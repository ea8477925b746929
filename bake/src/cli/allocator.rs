//! How the system's allocator gives memory back.

/// Blocks of at least this many bytes go back to the system as soon as they are freed.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
const DIRECT: libc::c_int = 256 << 10;

/// Makes large blocks go back to the system when they are freed.
///
/// A stage of a bake needs a few large arrays and frees them all. By default glibc learns from the
/// first of them to keep blocks of up to 32 MiB, which raised the peak by up to a quarter and beyond
/// what sizes of data explain. Only memory depends on this, no result.
pub(crate) fn give_back_large_blocks() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    {
        #[expect(unsafe_code, reason = "the C library has no other way to set this")]
        // SAFETY: the call has no precondition but a known parameter, and no other thread runs yet.
        let set = unsafe { libc::mallopt(libc::M_MMAP_THRESHOLD, DIRECT) };
        // A refusal leaves the default, which works as well with more memory.
        debug_assert!(set == 1, "the threshold is within its range");
    }
}
