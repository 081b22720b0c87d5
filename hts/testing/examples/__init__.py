"""Small plugin packages: the kit tests with them, and `hts new` writes them under another name."""
