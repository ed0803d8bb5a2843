"""What a cell needs beside measuring: doctor, emulator, tracker bridge."""
