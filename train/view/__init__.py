"""A learned motion to look at: in MuJoCo's viewer, or in a web page with scenes, arms and motions (extra "view")."""
