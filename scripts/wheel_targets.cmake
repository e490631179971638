# For building ROS interface packages on the wheels, given to cmake as CMAKE_PROJECT_INCLUDE.
#
# The wheels' CMake targets name include directories of the machine that built them, below
# /opt/python, which cmake refuses because they do not exist. Once a directory is read to its end,
# this drops them, so that the packages' own CMakeLists.txt stay as colcon and apt want them.
function(drop_include_directories_of_the_build_farm)
  get_property(targets DIRECTORY PROPERTY IMPORTED_TARGETS)
  foreach(target IN LISTS targets)
    get_target_property(directories ${target} INTERFACE_INCLUDE_DIRECTORIES)
    if(directories)
      list(FILTER directories EXCLUDE REGEX "^/opt/python/")
      set_target_properties(${target} PROPERTIES INTERFACE_INCLUDE_DIRECTORIES "${directories}")
    endif()
  endforeach()
endfunction()
cmake_language(DEFER CALL drop_include_directories_of_the_build_farm)
