"""Many runs by any number of workers that see one folder."""
