//! (solve)
