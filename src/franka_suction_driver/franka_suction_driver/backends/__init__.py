"""What moves the arm and runs the pump: libfranka, a controller behind topics, a stand-in."""
