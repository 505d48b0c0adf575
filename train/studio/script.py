def script(path: str) -> str:
    return f"# {path}"
